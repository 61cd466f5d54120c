"""Speed of tso beside other ways to do the same work."""
