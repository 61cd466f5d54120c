"""How good a cloud is, compared with a target cloud or with a mask."""
