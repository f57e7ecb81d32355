"""The command ``check-data``: a linter of BOP datasets.

`checks` runs all checks in order; each of `files`, `cameras`, `models`, `model_folders`, `poses`,
`boxes`, `images`, `depth`, `projection` and `pairs` is one group of them. `pose_mistakes` lists the
mistakes that explain a wrong projection, `units` the units. `findings` collects, `coverage` counts
what was checked, `check_data` prints, `overlays` draws.
"""
