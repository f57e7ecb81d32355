"""How quick things are, as ratios to what others would use: ``python tests/benchmarks --help``.

One file a comparison. Each has a function ``measure``, which takes the options and yields records
of the results file; ``config.GROUPS`` lists them.
"""
