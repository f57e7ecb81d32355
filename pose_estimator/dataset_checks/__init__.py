"""The command ``check-data``: a linter of BOP datasets.

`checks` runs all checks in order; each of `files`, `cameras`, `models`, `poses`, `boxes`, `images`,
`depth`, `projection` and `pairs` is one group of them. `pose_mistakes` lists the mistakes that
explain a wrong projection. `findings` collects, `check_data` prints, `overlays` draws them.
"""
