"""Sources of echoes at known positions (wires, edges, volumes, pairs): kinds, registry and construction."""
