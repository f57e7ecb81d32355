"""The command ``train-agent``: options in ``config.py``, the SB3 run in ``train_agent.py``.

``train_greedy.py`` and ``error_regression.py`` train the networks of ``greedy``;
``hyperparameters.yml`` has the tuned values; ``training_state.py`` saves and restores an SB3
trainer; ``step_count.py`` says how many steps are played; ``sub_environments.py`` adapts our vector
environment to SB3.
"""
