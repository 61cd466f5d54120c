"""Questions asked of the method; nothing of the product imports this."""
