"""Metric terms: what is measured of each control step, before it is reduced over the episode.

A term is a function of the state and the agent group that returns (N,), NaN where a step gives no value; its
keyword parameters are its settings. One that must remember something is a class. A term with the attribute
`needs_joints` reads the state of the joints (`group.motion.joints`), one with `needs_scan` a scan
(`group.nearest_return`).
"""
