"""Imports: the rooms' order is checked by lint-imports, and within a room no module imports itself by way of others."""

import grimp


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
