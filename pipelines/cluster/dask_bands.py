#!/usr/bin/env python3
"""Runs a pipeline in row bands on Dask workers, and merges them (docs/cluster.md).

Each task is one `photocurrent run MANIFEST --rows a..b --part FOLDER`, which may be run twice, or by two workers at once, without harm: so a lost worker
costs its band and nothing else. All workers must see the same files under the same paths.

    python pipelines/cluster/dask_bands.py pipelines/scale.toml --bands 8 --parts parts --workers 2
    python pipelines/cluster/dask_bands.py pipelines/scale.toml --bands 64 --parts /shared/parts --scheduler tcp://head:8786
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path

# What photocurrent ends with when trying again cannot help: a mistake in the manifest or the arguments, or in the input data.
FINAL = (2, 3)


class Refused(Exception):
    """The command will say the same the next time."""


def photocurrent(command):
    """Runs the command and gives what it printed; the end of its messages becomes the error."""
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    if done.returncode != 0:
        message = f"`{' '.join(command)}` ended with exit code {done.returncode}:\n{done.stderr[-4000:]}"
        raise Refused(message) if done.returncode in FINAL else RuntimeError(message)
    return done.stdout


def band(command, rows, part):
    """Makes one part; on a worker. What trying again cannot repair is given back instead of raised, so that Dask does not try again."""
    try:
        photocurrent([*command, "--rows", f"{rows[0]}..{rows[1]}", "--part", part, "--quiet"])
    except Refused as refused:
        return str(refused)
    return None


def split(rows, bands):
    """`bands` ranges of rows that follow each other, as equal as can be."""
    bands = max(1, min(bands, rows))
    edges = [rows * k // bands for k in range(bands + 1)]
    return list(zip(edges, edges[1:]))


def run(client, photocurrent_path, manifest, bands, parts, options=(), merge_options=(), retries=3):
    """Runs `manifest` in `bands` row bands on the workers of `client`, then merges; gives what `merge --json` says.

    `parts`: a folder that all workers see. `options`: for `run` and `merge` alike, such as `--set`, `--cache`, `--to`. Raises `Refused` or `RuntimeError`
    with the command's message when a band, or the merge, does not come to its end.
    """
    parts = Path(parts)
    parts.mkdir(parents=True, exist_ok=True)
    command = [photocurrent_path, "run", manifest, *options]
    # No rows: what must be whole before them, once, and how many rows there are.
    prepared = json.loads(photocurrent([*command, "--rows", "0..0", "--part", str(parts / "prepared"), "--json", "--quiet"]))
    ranges = split(prepared["all_rows"], bands)
    folders = [str(parts / f"rows-{start}-{end}") for start, end in ranges]
    futures = [client.submit(band, command, rows, folder, key=f"{folder}", retries=retries) for rows, folder in zip(ranges, folders)]
    refused = [message for message in client.gather(futures) if message]
    if refused:
        raise Refused(refused[0])
    merged = photocurrent([photocurrent_path, "merge", manifest, *folders, *options, *merge_options, "--json", "--quiet"])
    return json.loads(merged)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0], epilog="What follows -- is given to the command: -- --set nodes.a.params.b=1 --memory 4GiB")
    parser.add_argument("manifest")
    parser.add_argument("--bands", type=int, default=8, help="how many parts")
    parser.add_argument("--parts", required=True, help="folder for them; all workers must see it")
    parser.add_argument("--photocurrent", default="photocurrent", help="the command")
    parser.add_argument("--scheduler", help="address of a Dask scheduler; none = workers on this machine")
    parser.add_argument("--workers", type=int, default=2, help="processes on this machine, without --scheduler")
    arguments, options = parser.parse_known_args()
    options = [option for option in options if option != "--"]
    from distributed import Client, LocalCluster

    if arguments.scheduler:
        client = Client(arguments.scheduler)
    else:
        client = Client(LocalCluster(n_workers=arguments.workers, threads_per_worker=1, processes=True, dashboard_address=None))
    try:
        outcome = run(client, arguments.photocurrent, arguments.manifest, arguments.bands, arguments.parts, options)
    except (Refused, RuntimeError) as error:
        sys.exit(str(error))
    finally:
        client.close()
    print(json.dumps(outcome, indent=2))


if __name__ == "__main__":
    main()
