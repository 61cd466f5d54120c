"""Images, masks, cameras and ground truth of meshes, by ray casting.

Meshes are centred on their bounding box and scaled to longest side 1; y is up. The camera looks at
the origin. At azimuth 0 it looks along -z, and with growing azimuth it moves toward +x. At azimuth
and elevation 0 its R is the canonical rotation.
"""
