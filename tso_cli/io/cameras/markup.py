"""Values of a YAML or XML file; nothing is run, and nothing outside the file is read."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from ...errors import InputError
from ..output import reason

LARGEST_YAML = 1 << 20  # letters; lists of numbers of this size take up to 2 s
DEEPEST = 50  # calibrations nest 4 deep; a parser recurses
# Numbers that programs write and YAML 1.1 takes for words: OpenCV's .Nan, and 1e-05.
_FLOATS = r"^[-+]?(\.(inf|Inf|INF|nan|Nan|NaN|NAN)|\d+(\.\d*)?[eE][-+]?\d+)$"


def documents_of(text: str, path: Path) -> list[Any]:
    """The documents of a YAML file, or the values of an ``opencv_storage`` in XML."""
    return _of_xml(text, path) if text.lstrip().startswith("<") else _of_yaml(text, path)


def _of_yaml(text: str, path: Path) -> list[Any]:
    """The documents of a YAML file that are not empty.

    Tags of OpenCV are left out. Raises InputError for an alias, which makes a small file large, for
    any other tag, and for what is not YAML.
    """
    import yaml

    if len(text) > LARGEST_YAML:
        raise InputError(
            f"{path}: holds {len(text):,} letters, expected YAML of at most {LARGEST_YAML:,}"
        )

    class Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
        pass

    def without_tag(loader: Any, suffix: str, node: yaml.Node) -> Any:
        if not isinstance(node, yaml.MappingNode):
            raise yaml.YAMLError(f"the tag {suffix}")
        return loader.construct_mapping(node, deep=True)

    Loader.add_multi_constructor("tag:yaml.org,2002:opencv-", without_tag)
    Loader.add_implicit_resolver(
        "tag:yaml.org,2002:float", re.compile(_FLOATS), list("-+.0123456789")
    )
    # OpenCV writes the version as %YAML:1.0, which is no directive of YAML.
    text = re.sub(r"\A%YAML:?\s*[\d.]+\s*\n", "", text)
    try:
        depth = 0
        for event in yaml.parse(text, Loader):
            if isinstance(event, yaml.AliasEvent):
                raise yaml.YAMLError("it holds an alias")
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            if depth > DEEPEST:
                raise yaml.YAMLError("nested too deep")
        documents = list(yaml.load_all(text, Loader))
    except yaml.MarkedYAMLError as error:
        place = f", line {error.problem_mark.line + 1}" if error.problem_mark else ""
        raise InputError(
            f"{path}: is not YAML ({reason(ValueError(error.problem or error.context))}{place})"
        ) from None
    except (yaml.YAMLError, ValueError, TypeError, RecursionError, OverflowError) as error:
        first = (str(error).splitlines() or [""])[0].rstrip(":")
        raise InputError(f"{path}: is not YAML ({reason(ValueError(first))})") from None
    return [document for document in documents if document is not None]


def root_of(text: str, path: Path) -> Any:
    """The root element of an XML file; InputError for what is none, or declares a document type."""
    from xml.etree import ElementTree

    if re.search(r"<!(DOCTYPE|ENTITY)", text):
        raise InputError(f"{path}: declares a document type, expected plain XML")
    try:
        # The encoding that the file declares has no effect on text, and may be unknown.
        return ElementTree.fromstring(text.encode(), ElementTree.XMLParser(encoding="utf-8"))
    except ElementTree.ParseError as error:
        raise InputError(f"{path}: is not XML ({reason(error)})") from None


def _of_xml(text: str, path: Path) -> list[Any]:
    root = root_of(text, path)
    if root.tag != "opencv_storage":
        return []
    return [{element.tag: _value(element) for element in root}]


def _value(element: Any) -> Any:
    data = element.find("data")
    if data is not None:
        values: dict[str, Any] = {"data": _numbers(data.text)}
        for key in ("rows", "cols"):
            child = element.find(key)
            numbers = [] if child is None else _numbers(child.text)
            if len(numbers) == 1 and isinstance(numbers[0], float) and numbers[0] % 1 == 0:
                values[key] = int(numbers[0])
        return values
    numbers = _numbers(element.text)
    return numbers[0] if len(numbers) == 1 else numbers


def _numbers(text: str | None) -> list[Any]:
    words = (text or "").split()
    try:
        return [float(word) for word in words]
    except ValueError:
        return words
