"""Files -> what a refinement needs: the cloud or the network, the masks, and the cameras."""
