"""How the thirteen objects are made, from formulas: ``python -m two_view_pose.assets.build``.

Part of the checkout only: the package ships what this builds. Needs the extra ``build``.
"""
