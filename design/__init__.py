"""From a plant to a controller: modes, loops, reduction, LMI synthesis, certificates."""
