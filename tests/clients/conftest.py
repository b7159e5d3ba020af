"""Tests of other people's software: those whose package is not installed skip, and all make a table."""

from collections.abc import Sequence
from pathlib import Path

import pytest
from client_table import CLIENTS, PASSED, Row, installed_version, write_table


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--clients-table", metavar="FILE", help="write the table client x result into FILE")


def pytest_configure(config: pytest.Config) -> None:
    path = config.getoption("clients_table", None)
    if path and not hasattr(config, "workerinput"):
        config.pluginmanager.register(_TableOfClients(Path(path)))


def pytest_collection_modifyitems(items: Sequence[pytest.Item]) -> None:
    for item in items:
        for mark in item.iter_markers("client"):
            row = Row(*mark.args)
            item.user_properties.append(("client", list(mark.args)))
            needed = (row.client, *mark.kwargs.get("needs", ()))
            missing = ", ".join(CLIENTS[client] for client in needed if installed_version(client) is None)
            if missing:
                item.add_marker(pytest.mark.skip(f"without {missing}"))


class _TableOfClients:
    """Collects the results of marked tests, and writes the table at the end."""

    def __init__(self, path: Path) -> None:
        self._path, self._results = path, dict[Row, str]()

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        for name, value in report.user_properties:
            if name != "client":
                continue
            row, before = Row(*value), self._results.get(Row(*value))
            if report.failed:
                self._results[row] = "**fails**"
            elif report.skipped and before in (None, PASSED):
                self._results[row] = str(report.longrepr[2]).replace("Skipped: ", "skipped ")
            elif report.when == "call" and before is None:
                self._results[row] = PASSED

    def pytest_sessionfinish(self) -> None:
        write_table(self._path, self._results, Path(__file__).parent)
