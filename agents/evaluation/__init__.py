"""The commands ``evaluate-agent`` (``evaluate_agent.py``) and ``demo`` (``demo.py``).

``outcomes.py`` has the statistics and the results table, ``figures.py`` and ``sphere_figure.py``
the plots.
"""
