"""How good a cloud is: against a target cloud, or against a mask."""
