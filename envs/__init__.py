"""The Gymnasium environments, and the simulation, banks and datasets that belong to them.

``two_view_pose`` is the environment to read first; ``sequential`` has several steps an episode,
``replay`` plays recorded episodes, and ``base`` holds what the live ones share: ``actions``,
``observation`` and ``options`` convert what crosses their interface, ``episode`` records one
episode, ``copying`` copies an environment in mid-episode, ``protocol`` is the interface of a pose
estimator. Scenes and rendering are in ``simulation``, the vector environment in ``vector``,
recorded episodes in ``view_banks`` and ``recording``, BOP datasets in ``datagen``.
"""
