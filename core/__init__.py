"""What every other room may use: geometry, files, devices and processes.

``geometry`` has the conventions for frames, units and pixels; ``errors`` and ``validation`` the
input errors; ``results``, ``files`` and
``closed_output`` what commands write; ``device``, ``processor``,
``cpu_cores``, ``thread_pools`` and ``thread_waiting`` the hardware; ``worker_pool`` and ``memory``
processes; ``plotting``, ``images``, ``text_files``, ``image_crop`` and ``pose_noise`` the rest.
"""
