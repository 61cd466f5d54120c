"""Where a cloud stands before its cameras, found from masks, in numpy."""
