"""Many captures become one library of materials: on this machine, or on the machines of a Ray cluster."""
