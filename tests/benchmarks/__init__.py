"""Speed as ratios to alternatives: ``python tests/benchmarks --help``.

``groups/`` has one file per comparison, listed in ``config.GROUPS``; ``command.py`` runs them, each
in its own process, and ``results_file.py`` makes that resumable. ``stopwatch.py`` times,
``table.py`` formats. ``tests/`` tests the benchmarks; ``results/`` has the results in README.
"""
