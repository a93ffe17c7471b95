"""Two Dask workers give the bytes of one process, also when one of them is killed on its way.

    PHOTOCURRENT=target/release/photocurrent python -m unittest discover -s pipelines/cluster
"""

import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
import unittest
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))
import dask_bands  # noqa: E402
from distributed import Client, LocalCluster  # noqa: E402

COMMAND = str(Path(os.environ.get("PHOTOCURRENT", "photocurrent")).resolve())
MANIFEST = str(HERE.parent / "scale.toml")
SMALL = ["--set", "nodes.scene.params.width=48", "--set", "nodes.scene.params.height=40", "--set", 'nodes.scene.params.duration="60 ms"']


def digests(outcome):
    return {task["node"]: {port: output["digest"] for port, output in task["outputs"].items()} for task in outcome["tasks"]}


def pictures(out):
    return {str(path.relative_to(out)): path.read_bytes() for path in sorted(Path(out).rglob("*")) if path.is_file() and path.suffix == ".png"}


class TwoWorkers(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.TemporaryDirectory()
        self.addCleanup(self.folder.cleanup)
        self.top = Path(self.folder.name)

    def options(self, name):
        return [*SMALL, "--cache", str(self.top / f"cache-{name}"), "--out", str(self.top / f"out-{name}")]

    def one_process(self):
        done = subprocess.run([COMMAND, "run", MANIFEST, *self.options("one"), "--json", "--quiet"], check=True, stdout=subprocess.PIPE, text=True)
        return digests(json.loads(done.stdout)), pictures(self.top / "out-one")

    def on_workers(self, name, disturb=None):
        with LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster, Client(cluster) as client:
            disturber = threading.Thread(target=disturb, args=(client,)) if disturb else None
            if disturber:
                disturber.start()
            outcome = dask_bands.run(client, COMMAND, MANIFEST, 4, self.top / f"parts-{name}", self.options(name))
            if disturber:
                disturber.join()
        return digests(outcome), pictures(self.top / f"out-{name}")

    def test_bands_on_workers_are_the_bytes_of_one_process(self):
        expected = self.one_process()
        self.assertGreater(len(expected[1]), 10)
        self.assertEqual(self.on_workers("two"), expected)

    def test_a_worker_that_is_killed_changes_nothing(self):
        killed = []

        def kill_one(client):
            # As soon as a worker has something to do.
            for _ in range(10000):
                busy = {worker: tasks for worker, tasks in client.processing().items() if tasks}
                if busy:
                    victim = client.run(os.getpid, workers=[next(iter(busy))])
                    for pid in victim.values():
                        os.kill(pid, signal.SIGKILL)
                        killed.append(pid)
                    return
                time.sleep(0.01)

        expected = self.one_process()
        self.assertEqual(self.on_workers("killed", kill_one), expected)
        self.assertEqual(len(killed), 1, "a worker was killed while it worked")

    def test_a_mistake_is_reported_and_not_tried_again(self):
        with LocalCluster(n_workers=1, threads_per_worker=1, processes=True, dashboard_address=None) as cluster, Client(cluster) as client:
            with self.assertRaises(dask_bands.Refused) as caught:
                dask_bands.run(client, COMMAND, MANIFEST, 2, self.top / "parts", [*self.options("bad"), "--set", "nodes.solve.params.methd=map"])
        self.assertIn("methd", str(caught.exception))


if __name__ == "__main__":
    unittest.main()
