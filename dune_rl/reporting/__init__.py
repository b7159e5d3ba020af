"""Reports: from the folders of trainings, evaluations and sweeps to tables, figures and a page."""
