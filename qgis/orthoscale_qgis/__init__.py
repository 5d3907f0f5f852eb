"""QGIS Processing algorithms that call the program orthoscale."""


def classFactory(interface):
    """The plugin, as QGIS asks for it; `interface` is None in qgis_process."""
    from .plugin import Plugin

    return Plugin()
