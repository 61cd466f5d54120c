"""A reader of cameras, as another package registers it under the entry point `tso.cameras`."""

import numpy as np

from tso_cli.io.cameras import PartialCamera, of_pixels


class Reader:
    """Files of one line: NUMBERS f cx cy x y z, a camera that looks along z."""

    def recognises(self, source):
        return source.data.startswith(b"NUMBERS ")

    def read(self, source):
        f, cx, cy, *t = map(float, source.text.split()[1:])
        K = np.array([[f, 0.0, cx], [0.0, f, cy], [0.0, 0.0, 1.0]])
        return [PartialCamera("the camera", of_pixels(K, None), np.eye(3), np.array(t))]
