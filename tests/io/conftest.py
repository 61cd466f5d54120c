import json

import numpy as np
import pytest


@pytest.fixture
def save(tmp_path):
    """Write bytes, text, an array (.npy) or a JSON document to a file of tmp_path."""

    def write(name, content):
        path = tmp_path / name
        if isinstance(content, np.ndarray):
            np.save(path, content, allow_pickle=True)
        elif isinstance(content, bytes):
            path.write_bytes(content)
        else:
            path.write_text(
                content if isinstance(content, str) else json.dumps(content), newline=""
            )
        return path

    return write
