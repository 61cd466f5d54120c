"""Questions asked of the method, answered with records."""
