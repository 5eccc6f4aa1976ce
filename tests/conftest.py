def pytest_collection_modifyitems(items):
    """Begin with the long tests: at the end one process would wait for another that has just begun one."""
    items.sort(key=lambda item: item.get_closest_marker("long") is None)
