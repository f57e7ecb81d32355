"""The comparative study of the paper, which the command ``compare`` runs.

``config.py`` has its options, ``plan.py`` what is run, and ``run.py`` runs it from options to
records. ``measure.py`` measures one method on one test and ``log.py`` keeps each outcome, so that a
run is resumable. ``tables.py`` turns outcomes into the records of results.json; ``report.py``,
``report_tables.py`` and ``figures.py`` turn those into a page. ``gallery.py``, ``images.py`` and
``insides.py`` draw examples; ``cost.py`` times the methods. ``published.py`` holds the paper's
results.
"""
