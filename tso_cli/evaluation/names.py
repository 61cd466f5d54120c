"""The names that `tso eval` knows."""

METRICS = ("chamfer", "f_score", "emd", "iou")
PROTOCOLS = ("plain", "capnet")
# The fields of each metric in a record, in the order of the table.
FIELDS = {
    "chamfer": ("forward", "backward", "chamfer"),
    "f_score": ("precision", "recall", "f_score"),
    "emd": ("emd",),
    "iou": ("iou",),
}
