"""Workers for batches: threads of the test's own process, and a scheduler with processes."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from distributed import Client, LocalCluster

from tests.workflows.batch.cluster_processes import Cluster
from tests.workflows.batch.stub_call import StubCall


@pytest.fixture
def stub(tmp_path: Path) -> StubCall:
    counts = tmp_path / "counts"
    counts.mkdir()
    return StubCall(counts=counts)


@pytest.fixture(scope="module")
def threads() -> Iterator[Client]:
    """Two workers of a thread each, in this process."""
    with (
        LocalCluster(
            n_workers=2,
            threads_per_worker=1,
            processes=False,
            dashboard_address="127.0.0.1:0",
            worker_dashboard_address="127.0.0.1:0",
        ) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        yield client


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    """A scheduler without workers."""
    folder = tmp_path / "cluster"
    folder.mkdir()
    made = Cluster(folder)
    try:
        made.start_scheduler()
        yield made
    finally:
        made.stop()
