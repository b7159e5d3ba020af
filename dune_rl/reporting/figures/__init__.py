"""Figures of reports: functions that return a matplotlib `Figure` with an Agg canvas, without pyplot.

A method has the same style in every figure of the same methods in the same order. Save within
`rc_context(style.RC)`, so that PDFs embed fonts as outlines. Without data a figure says why it is empty.
"""
