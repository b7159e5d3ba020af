"""Figures of reports. Every function returns a matplotlib `Figure` with an Agg canvas, without pyplot.

`Results` are the rows of episodes by cases and method: {"inspection-v1": {"planner": [row, ...]}}; a report
gives the methods the names that its tables have (`drawing.results_of` and `drawing.method_runs` make them of
comparisons). A method has the same style in every figure of the same methods in the same order. Save
within `rc_context(style.RC)`, so that PDFs embed fonts as outlines. Nothing to draw gives a small figure that
says why.

    training.by_world(groups) -> dict[str, groups]        groups: runs by name; a figure for each world
    training.draw_training_curves(groups) -> Figure                     SR and return; evaluation and training
    training.draw_learning_curve(groups, metric="SR") -> Figure         evaluation alone, at column width
    distributions.distribution_metrics(results) -> list[str]
    distributions.draw_distributions(results, metric) -> Figure
    success.draw_success_by(results, name) -> Figure                    name: "goal_distance_m" or "slope_deg"
    aggregates.collect_scores(results, metric="success", runs=None) -> MethodScores
    aggregates.draw_aggregates(scores) -> Figure                        IQM, median, mean, optimality gap
    aggregates.draw_profiles(scores) -> Figure
    aggregates.draw_improvements(scores) -> Figure                      probability of improvement, all pairs
    track_data.collect_tracks(methods, most_sites=3, most_episodes=4) -> list[TrackSite]
    tracks.draw_tracks(sites) -> Figure                                 needs steps; of one set of cases
    failures.collect_failures(methods, each=1, most=12, progress, simulate=True) -> FailureGallery
    failures.draw_failures(gallery) -> Figure                           gallery.left_out: what is not, and why
"""
