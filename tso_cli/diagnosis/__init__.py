"""Is the input meant as it is given? Hypotheses, symptoms, and the confidence in a result."""
