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

    def on_workers(self, name, disturb=None, pids=None, stop=None):
        with LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster, Client(cluster) as client:
            if disturb:
                pids.update(client.run(os.getpid))
                disturber = threading.Thread(target=disturb, args=(client,))
                disturber.start()
            try:
                outcome = dask_bands.run(client, COMMAND, MANIFEST, 4, self.top / f"parts-{name}", self.options(name))
            finally:
                if disturb:
                    stop.set()
                    disturber.join()
        return digests(outcome), pictures(self.top / f"out-{name}")

    def test_bands_on_workers_are_the_bytes_of_one_process(self):
        expected = self.one_process()
        self.assertGreater(len(expected[1]), 10)
        self.assertEqual(self.on_workers("two"), expected)

    def test_a_worker_that_is_killed_changes_nothing(self):
        killed, pids, stop = [], {}, threading.Event()

        def kill_one(client):
            # As soon as a worker has something to do, and while the others wait for its like.
            while not stop.is_set():
                busy = {worker: tasks for worker, tasks in client.processing().items() if tasks}
                if busy:
                    victim = next(iter(busy))
                    os.kill(pids[victim], signal.SIGKILL)
                    killed.append(pids[victim])
                    return
                time.sleep(0.01)

        expected = self.one_process()
        self.assertEqual(self.on_workers("killed", kill_one, pids, stop), expected)
        self.assertEqual(len(killed), 1, "a worker was killed while it worked")

    def test_a_mistake_is_reported_and_not_tried_again(self):
        with LocalCluster(n_workers=1, threads_per_worker=1, processes=True, dashboard_address=None) as cluster, Client(cluster) as client:
            with self.assertRaises(dask_bands.Refused) as caught:
                dask_bands.run(client, COMMAND, MANIFEST, 2, self.top / "parts", [*self.options("bad"), "--set", "nodes.solve.params.methd=map"])
        self.assertIn("methd", str(caught.exception))


if __name__ == "__main__":
    unittest.main()
