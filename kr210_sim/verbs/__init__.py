"""The verbs of the command line: one module each, with `add(verbs)` for its options."""
