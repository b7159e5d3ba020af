"""The sources of tables in Markdown files: a method's episodes in a folder."""

from pathlib import Path

from dune_rl.errors import ConfigError
from dune_rl.reporting.comparisons import Method, collect_comparisons
from dune_rl.reporting.reading import read_inputs
from dune_rl.settings import Settings


class SourceConf(Settings):
    """A method's episodes: of a folder, and of one of its policies where it has several."""

    folder: str
    policy: str | None = None


def find_method(source: str | SourceConf, beside: Path) -> Method:
    """The episodes of a source, whose folder is relative to the folder `beside`.

    Raises ConfigError unless there is exactly one method.
    """
    conf = SourceConf(folder=source) if isinstance(source, str) else source
    inputs = read_inputs([beside / conf.folder])
    methods = [
        method
        for comparison in collect_comparisons(inputs.evaluations)
        for method in comparison.methods
        if conf.policy in (None, method.policy)
    ]
    if len(methods) == 1:
        return methods[0]
    if not methods:
        reason = f": {inputs.skipped[0].text}" if inputs.skipped else ""
        raise ConfigError(f"{conf.folder} has no episodes of {conf.policy or 'a policy'}{reason}")
    policies = ", ".join(dict.fromkeys(method.policy for method in methods))
    raise ConfigError(f"{conf.folder} has several methods ({policies}); name one folder and policy")
