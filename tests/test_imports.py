"""What the rooms may import and say; lint-imports checks the order of the rooms."""

import ast
import re
from pathlib import Path

import grimp

import tso_cli

PACKAGE = Path(tso_cli.__file__).parent


def test_no_module_imports_itself_by_way_of_others():
    graph = grimp.build_graph("tso_cli", exclude_type_checking_imports=True)
    modules = graph.modules
    imports = [
        (one, other) for one in modules for other in graph.find_modules_directly_imported_by(one)
    ]
    assert len(imports) > len(modules) > 200
    assert [
        pair for pair in imports if graph.chain_exists(importer=pair[1], imported=pair[0])
    ] == []


def _text_of(tree: ast.AST) -> list[str]:
    """The strings of a module that are no docstrings."""
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef)
    docstrings = {
        id(node.body[0].value)
        for node in ast.walk(tree)
        if isinstance(node, documented) and node.body and isinstance(node.body[0], ast.Expr)
    }
    return [
        node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant)
        and isinstance(node.value, str)
        and id(node) not in docstrings
    ]


def test_only_the_command_line_names_options():
    naming = [
        f"{path.relative_to(PACKAGE)}: {text}"
        for path in sorted(PACKAGE.rglob("*.py"))
        if path.relative_to(PACKAGE).parts[0] not in ("commands", "cli.py", "examples")
        for text in _text_of(ast.parse(path.read_text()))
        if re.search(r"(?<![\w-])--[a-z]", text)
    ]
    assert naming == []


def test_signals_wait_while_a_library_that_takes_ctrl_c_for_a_missing_part_is_imported():
    def imports(node):
        names = [alias.name for alias in getattr(node, "names", ())]
        named = [node.module or ""] if isinstance(node, ast.ImportFrom) else names
        return any(name.split(".")[0] in ("trimesh", "open3d") for name in named)

    found, waiting = set(), set()
    for path in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, (ast.Import, ast.ImportFrom)) and imports(node):
                found.add((path, node.lineno))
            elif isinstance(node, ast.With) and "waiting_signals()" in ast.unparse(node.items[0]):
                waiting |= {(path, one.lineno) for one in node.body}
    assert found
    assert found <= waiting
