"""The studies: each module a question, its cases and its tables; their names stand here, so that a list imports none."""

QUESTIONS = {
    "accuracy": ("accuracy", "How much nearer to the truth does a refinement come, and how often further away?"),
    "evidence": ("evidence", "What is other evidence worth than one right mask of the whole object?"),
    "tso": ("variants", "What gains most at test stage: moving the encoder, encoder and decoder, or the points?"),
    "pose": ("pose", "How well is a camera found from mask and cloud alone?"),
    "network": ("network", "How good is the base network on unseen shapes?"),
    "supervision": ("supervision", "What does a network learn from points, from masks and from other projections?"),
    "views": ("views", "How many masks of each object should supervise a step?"),
    "lambda": ("weight", "What does lambda, the weight of the affinity loss, change?"),
    "affinity": ("affinity", "Does the affinity loss remove outliers?"),
    "sigma": ("sigma", "How wide should the Gaussian be?"),
    "failures": ("failures", "Do the paper's two failures show: narrow aeroplanes, cars deformed in depth?"),
}
"""Name of the command -> (its module in this package, whose ``STUDY`` is the `Study`; the question)."""
