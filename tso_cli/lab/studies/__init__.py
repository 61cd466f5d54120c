"""The studies: each module a question, its cases and its tables; all are named here, so that a list imports none."""

QUESTIONS = {
    "accuracy": (
        "studies.accuracy.STUDY",
        "How much nearer to the truth does a refinement come, and how often further away?",
    ),
    "evidence": (
        "studies.evidence.STUDY",
        "What is other evidence worth than one right mask of the whole object?",
    ),
    "confidence": ("studies.confidence.STUDY", "Does the tool know when it failed?"),
    "tso": (
        "studies.variants.STUDY",
        "What gains most at test stage: moving the encoder, encoder and decoder, or the points?",
    ),
    "pose": ("studies.pose.STUDY", "How well is a camera found from mask and cloud alone?"),
    "network": ("studies.network.STUDY", "How good is the base network on unseen shapes?"),
    "supervision": (
        "studies.supervision.STUDY",
        "What does a network learn from points, from masks and from other projections?",
    ),
    "views": (
        "studies.supervision.VIEWS",
        "How many masks of each object should supervise a step?",
    ),
    "lambda": (
        "studies.affinity.LAMBDA",
        "What does lambda, the weight of the affinity loss, change?",
    ),
    "affinity": ("studies.affinity.STUDY", "Does the affinity loss remove outliers?"),
    "sigma": ("studies.sigma.STUDY", "How wide should the Gaussian be?"),
    "failures": (
        "studies.failures.STUDY",
        "Do the paper's two failures show: narrow aeroplanes, cars deformed in depth?",
    ),
}
"""Command of `tso lab` -> (module in `tso_cli.lab`, and name in it, of its `Study`; the question)."""
BENCHES = {
    "speed": ("bench.speed.STUDY", "How fast is it, beside other ways and other packages?"),
    "pareto": (
        "bench.pareto.STUDY",
        "What accuracy costs in seconds: every mode and preset, swept over steps, points, pixels and masks, beside other ways "
        "to compare points with a mask.",
    ),
    "budget": (
        "bench.budget.STUDY",
        "What does `--budget auto` save, and what does that cost, from a brick to a lattice of struts?",
    ),
    "stability": (
        "stability.study.STUDY",
        "How wrong may masks, cameras, clouds and settings be, and does the tool say so?",
    ),
}
"""The same of `tso bench`."""
