"""The vector environment that ``gym.make_vec`` returns.

``env`` batches the pose estimates of its sub-environments; ``remote_simulator`` sets up and renders
their scenes in worker processes.
"""
