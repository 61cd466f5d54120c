"""The studies: each module a question, its cases and its tables; their names stand here, so that a list imports none."""

QUESTIONS = {
    "accuracy": ("accuracy.STUDY", "How much nearer to the truth does a refinement come, and how often further away?"),
    "evidence": ("evidence.STUDY", "What is other evidence worth than one right mask of the whole object?"),
    "confidence": ("confidence.STUDY", "Does the tool know when it failed?"),
    "tso": ("variants.STUDY", "What gains most at test stage: moving the encoder, encoder and decoder, or the points?"),
    "pose": ("pose.STUDY", "How well is a camera found from mask and cloud alone?"),
    "network": ("network.STUDY", "How good is the base network on unseen shapes?"),
    "supervision": ("supervision.STUDY", "What does a network learn from points, from masks and from other projections?"),
    "views": ("supervision.VIEWS", "How many masks of each object should supervise a step?"),
    "lambda": ("affinity.LAMBDA", "What does lambda, the weight of the affinity loss, change?"),
    "affinity": ("affinity.STUDY", "Does the affinity loss remove outliers?"),
    "sigma": ("sigma.STUDY", "How wide should the Gaussian be?"),
    "failures": ("failures.STUDY", "Do the paper's two failures show: narrow aeroplanes, cars deformed in depth?"),
}
"""Name of the command -> (module in this package, and name in it, of its `Study`; the question)."""
