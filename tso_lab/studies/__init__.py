"""The studies: each module holds a question, its cases and its tables."""

QUESTIONS = {
    "accuracy": (
        "studies.accuracy.STUDY",
        "How much nearer to the truth does a refinement come, and how often further away?",
    ),
    "pareto": ("bench.pareto.STUDY", "What does accuracy cost in seconds?"),
    "speed": ("bench.speed.STUDY", "How fast is tso, and how fast are other ways?"),
    "scale": ("bench.scale.STUDY", "How fast are batches, and what is left of a killed one?"),
    "harm": (
        "harm.study.STUDY",
        "How often does a cloud get worse in the field, and does tso say so?",
    ),
    "confidence": ("studies.confidence.STUDY", "Does tso know when it failed?"),
    "evidence": (
        "studies.evidence.STUDY",
        "What do depth maps, photos and missing parts change?",
    ),
    "determined": (
        "studies.determined.STUDY",
        "How much of a shape does the evidence determine?",
    ),
    "pose": ("studies.pose.STUDY", "How well is a camera found from mask and cloud alone?"),
    "moves": ("studies.moves.STUDY", "What does moving a cloud as one bring?"),
    "prior": ("studies.priors.STUDY", "What does a learned prior learn from, and for how long?"),
    "network": ("studies.network.STUDY", "How good is the base network on unseen shapes?"),
    "tso": (
        "studies.variants.STUDY",
        "Paper: what gains most, moving the encoder, encoder and decoder, or the points?",
    ),
    "supervision": (
        "studies.paper.SUPERVISION",
        "Paper: what does a network learn from points, masks and other projections?",
    ),
    "views": (
        "studies.paper.VIEWS",
        "Paper: how many masks of each object should supervise a step?",
    ),
    "lambda": (
        "studies.paper.LAMBDA",
        "Paper: what does lambda, the weight of the affinity loss, change?",
    ),
    "affinity": ("studies.paper.AFFINITY", "Paper: does the affinity loss remove outliers?"),
    "sigma": ("studies.sigma.STUDY", "Paper: how wide should the Gaussian be?"),
    "failures": (
        "studies.paper.FAILURES",
        "Paper: are aeroplanes too narrow, and cars deformed in depth?",
    ),
}
"""Command of `tso lab` -> (module in `tso_lab` and name in it of the `Study`, the question)."""
