#!/usr/bin/env python3
"""Writes the small HDF5 files next to this script, as other programs write them.

Needs: pip install h5py==3.16.0 hdf5plugin==7.1.0 numpy. Run in this folder. The numbers follow formulas that src/store/tests/foreign.rs and
src/formats/hdf/tests.rs repeat; nothing of them comes from a dataset.
"""

import h5py
import hdf5plugin
import numpy as np

N = 300


def filters():
    """One column of every number type, and the same numbers through every filter."""
    i = np.arange(N, dtype=np.int64)
    numbers = (i * i) % 1009 + 3 * i
    with h5py.File("filters.h5", "w", libver="earliest") as file:
        for name in ["u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f4", "f8", ">u2", ">i8", ">f8"]:
            values = numbers % 100 if name in ("u1", "i1") else numbers
            file.create_dataset("plain/" + name.replace(">", "big_"), data=values.astype(name))
        file.create_dataset("plain/bool", data=(i % 3 == 0))
        blosc = hdf5plugin.Blosc
        packed = {
            "gzip": dict(compression="gzip", shuffle=True),
            "lzf": dict(compression="lzf", shuffle=True),
            "lzf_plain": dict(compression="lzf"),
            "fletcher": dict(fletcher32=True),
            "gzip_fletcher": dict(compression="gzip", shuffle=True, fletcher32=True),
            "zstd": hdf5plugin.Zstd(),
            "lz4": hdf5plugin.LZ4(nbytes=1024),
            "bitshuffle": hdf5plugin.Bitshuffle(cname="none"),
            "bitshuffle_lz4": hdf5plugin.Bitshuffle(cname="lz4", nelems=128),
            "bitshuffle_zstd": hdf5plugin.Bitshuffle(cname="zstd"),
        }
        for codec in ["blosclz", "lz4", "lz4hc", "zlib", "zstd"]:
            for order, shuffle in [("plain", blosc.NOSHUFFLE), ("byte", blosc.SHUFFLE), ("bit", blosc.BITSHUFFLE)]:
                packed[f"blosc_{codec}_{order}"] = blosc(cname=codec, clevel=5, shuffle=shuffle)
        for name, how in packed.items():
            file.create_dataset("packed/" + name, data=numbers.astype("u4"), chunks=(200,), **how)
        # A chunk in many blocks, so that blocks and a shorter last one occur.
        long = (np.arange(40_000, dtype=np.int64) // 37).astype("u8")
        file.create_dataset("long/blosc", data=long, chunks=(30_000,), **blosc(cname="zstd", clevel=9, shuffle=blosc.SHUFFLE))
        file.create_dataset("long/blosclz", data=long, chunks=(30_000,), **blosc(cname="blosclz", clevel=9, shuffle=blosc.BITSHUFFLE))
        file.create_dataset("long/bitshuffle", data=long, chunks=(30_001,), **hdf5plugin.Bitshuffle(cname="zstd"))
        file.create_dataset("unknown/bzip2", data=numbers, chunks=(200,), **hdf5plugin.BZip2())
        file["table"] = np.stack([numbers, i % 40, i % 30, i % 2], axis=1).astype("u4")
        one = np.zeros(N, dtype={"names": ["x", "y", "p", "t"], "formats": ["<u2", "<u2", "<i2", "<i8"], "offsets": [0, 2, 4, 8], "itemsize": 16})
        one["x"], one["y"], one["p"], one["t"] = i % 40, i % 30, i % 2, numbers
        file["compound"] = one
        file["scalar"] = np.int64(1234567890123)
        file.attrs["text"] = "a text"
        file.attrs["bytes"] = np.bytes_("640x480")
        file.attrs["numbers"] = [480, 640]
        file.attrs["number"] = 0.5
        file["text"] = "a longer text"


def dsec():
    """The layout of DSEC, packed as it is: Blosc with Zstandard."""
    i = np.arange(5000, dtype=np.int64)
    t = i * 13
    pack = hdf5plugin.Blosc(cname="zstd", clevel=1, shuffle=hdf5plugin.Blosc.SHUFFLE)
    with h5py.File("dsec_blosc_zstd.h5", "w") as file:
        file.create_dataset("events/x", data=((i * 7) % 640).astype("u2"), chunks=(2048,), **pack)
        file.create_dataset("events/y", data=((i * 11) % 480).astype("u2"), chunks=(2048,), **pack)
        file.create_dataset("events/p", data=(i % 2).astype("u1"), chunks=(2048,), **pack)
        file.create_dataset("events/t", data=t.astype("u4"), chunks=(2048,), **pack)
        # t[ms_to_idx[ms]] >= ms * 1000 and t[ms_to_idx[ms] - 1] < ms * 1000
        file.create_dataset("ms_to_idx", data=np.searchsorted(t, np.arange(0, t[-1] // 1000 + 1) * 1000).astype("u8"), **pack)
        file["t_offset"] = np.int64(49_599_000_000)


def events(count, width, height):
    """Columns t (us), x, y, p that follow a formula."""
    i = np.arange(count, dtype=np.int64)
    return i * 13, (i * 7) % width, (i * 11) % height, i % 2


def m3ed():
    t, x, y, p = events(3000, 1280, 720)
    with h5py.File("m3ed.h5", "w") as file:
        for name, values in {"x": x.astype("u2"), "y": y.astype("u2"), "t": t, "p": p.astype("u1")}.items():
            file.create_dataset("prophesee/right/" + name, data=values, compression="lzf")
            file.create_dataset("prophesee/left/" + name, data=values[:1000], compression="lzf")
        file["prophesee/left/calib/resolution"] = [1280, 720]
        file["prophesee/right/calib/resolution"] = [1280, 720]
        file.create_dataset("prophesee/right/ms_map_idx", data=np.searchsorted(t, np.arange(0, t[-1] // 1000 + 1) * 1000), compression="lzf")
        file.create_dataset("ovc/left/data", data=np.arange(3 * 4 * 6).reshape(3, 4, 6, 1).astype("u1"), chunks=(1, 4, 6, 1), compression="lzf")
        file.create_dataset("ovc/rgb/data", data=np.arange(3 * 4 * 6 * 3).reshape(3, 4, 6, 3).astype("u1"), chunks=(1, 4, 6, 3), compression="lzf")
        file["ovc/ts"] = np.array([0, 40_000, 80_000])


def mvsec():
    t, x, y, p = events(2000, 346, 260)
    with h5py.File("mvsec.h5", "w") as file:
        file["davis/left/events"] = np.stack([x, y, 1_504_645_177 + t * 1e-6, 2 * p - 1], axis=1).astype("f8")
        images = np.zeros((2, 260, 346), dtype="u1")
        images[1, 5, 7] = 200
        file.create_dataset("davis/left/image_raw", data=images, compression="gzip", chunks=(1, 260, 346))
        file["davis/left/image_raw_ts"] = 1_504_645_177 + np.array([0.001, 0.023])


def v2e():
    t, x, y, p = events(2000, 346, 260)
    with h5py.File("v2e.h5", "w") as file:
        file.create_dataset("events", data=np.stack([t, x, y, p], axis=1).astype("u4"), maxshape=(None, 4), compression="gzip")
        file.create_dataset("frame", data=np.zeros((2, 260, 346), dtype="u1"), compression="gzip")
        file["frame_ts"] = np.array([0, 10_000], dtype="u8")
        file["frame_idx"] = np.array([0, 769], dtype="u8")


def event_utils():
    t, x, y, p = events(2000, 40, 30)
    with h5py.File("event_utils.h5", "w") as file:
        file["events/xs"], file["events/ys"] = x.astype("i2"), y.astype("i2")
        file["events/ts"], file["events/ps"] = t * 1e-6, p == 1
        for k in range(2):
            file[f"images/image{k:09d}"] = np.arange(30 * 40 * 3).reshape(30, 40, 3).astype("u1") + k
            image = file[f"images/image{k:09d}"]
            image.attrs["size"], image.attrs["timestamp"], image.attrs["type"] = image.shape, 0.001 + 0.01 * k, "color_bgr"
        file.attrs["sensor_resolution"], file.attrs["num_events"] = (30, 40), 2000


CD = {"names": ["x", "y", "p", "t"], "formats": ["<u2", "<u2", "<i2", "<i8"], "offsets": [0, 2, 4, 8], "itemsize": 16}
TRIGGER = {"names": ["p", "t", "id"], "formats": ["<i2", "<i8", "<i2"], "offsets": [0, 8, 16], "itemsize": 24}


def runs(values):
    """Lengths of runs of equal values."""
    edges = np.flatnonzero(np.diff(values)) + 1
    return np.diff(np.concatenate([[0], edges, [len(values)]]))


def ecf(t, x, y, p, how):
    """Packs events as the published description of the codec says; `how`: 0 masked, 1 x and p together, 2 y, x and p together."""
    out = (len(t) << 2 | (how == 2) << 1 | (how == 1)).to_bytes(4, "little") + int(t[0]).to_bytes(8, "little")
    now, at = int(t[0]), 0
    for run in runs(t):
        step = int(t[at]) - now
        now = int(t[at])
        if step >= 15:
            while step:
                out += bytes([0xF0 | step & 15])
                step >>= 4
            step = 0
        out += bytes([step << 4 | run]) if run < 15 else bytes([step << 4 | 15]) + int(run).to_bytes(2, "little")
        at += run
    if how == 2:
        v = [int(a) << 12 | int(b) << 1 | int(c) for a, b, c in zip(y, x, p)] + [0] * 3
        for k in range(0, len(t), 4):
            for word in (v[k] << 8 | v[k + 1] & 0xFF, v[k + 1] >> 8 << 16 | v[k + 2] & 0xFFFF, v[k + 2] >> 16 << 24 | v[k + 3]):
                out += word.to_bytes(4, "little")
        return out
    at = 0
    for run in runs(y):
        word = int(y[at]) << 5
        out += (word | int(run)).to_bytes(2, "little") if run < 31 else (word | 31).to_bytes(2, "little") + int(run).to_bytes(2, "little")
        at += run
    if how == 1:
        v = [int(b) << 1 | int(c) for b, c in zip(x, p)] + [0] * 3
        for k in range(0, len(t), 4):
            for word in (v[k] << 4 | v[k + 1] & 15, v[k + 1] >> 4 << 8 | v[k + 2] & 0xFF, v[k + 2] >> 8 << 12 | v[k + 3]):
                out += word.to_bytes(2, "little")
        return out
    at = 0
    while at < len(x):
        first, mask = int(x[at]), 0
        at += 1
        for j in range(5):
            if at < len(x) and int(x[at]) == first + j + 1:
                mask |= 1 << (4 - j)
                at += 1
        out += (first << 5 | mask).to_bytes(2, "little")
    at = 0
    for run in runs(p):
        out += bytes([int(p[at]) << 7 | int(run)]) if run < 127 else bytes([int(p[at]) << 7 | 127]) + int(run).to_bytes(2, "little")
        at += run
    return out


def prophesee():
    """CD/events packed by ECF, one chunk in each of its three ways, and the same events without a filter."""
    i = np.arange(3000, dtype=np.int64)
    # Runs of equal stamps and rows, steps small and large, neighbours in x.
    t, x, y, p = 913_716_224 + i // 3 * 2 + i // 40 * 1000, i * 3 % 7 + i // 5 % 600, i // 50 % 480, i // 200 % 2
    cd = np.zeros(3000, dtype=CD)
    cd["t"], cd["x"], cd["y"], cd["p"] = t, x, y, p
    trigger = np.zeros(4, dtype=TRIGGER)
    trigger["p"], trigger["t"], trigger["id"] = [1, 0, 1, 0], 913_716_224 + np.arange(4) * 500, [0, 0, 0, 0]
    for name in ["prophesee_plain.h5", "prophesee_ecf.h5"]:
        with h5py.File(name, "w") as file:
            file.attrs["geometry"], file.attrs["serial_number"] = np.bytes_("640x480"), np.bytes_("00000293")
            if name == "prophesee_plain.h5":
                file.create_dataset("CD/events", data=cd, chunks=(1024,))
            else:
                how = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
                how.set_chunk((1024,))
                how.set_filter(0x8ECF, h5py.h5z.FLAG_OPTIONAL)
                space = h5py.h5s.create_simple((3000,), (h5py.h5s.UNLIMITED,))
                dataset = h5py.h5d.create(file.create_group("CD").id, b"events", h5py.h5t.py_create(np.dtype(CD)), space, how)
                for k in range(3):
                    part = np.zeros(1024, dtype=CD)
                    here = cd[k * 1024 : (k + 1) * 1024]
                    part[: len(here)] = here
                    # Stamps must not fall: the encoder's own buffer is padded with whatever was there.
                    part["t"][len(here) :] = here["t"][-1]
                    dataset.write_direct_chunk((k * 1024,), ecf(part["t"], part["x"], part["y"], part["p"], k))
            file["EXT_TRIGGER/events"] = trigger


if __name__ == "__main__":
    for make in [filters, dsec, m3ed, mvsec, v2e, event_utils, prophesee]:
        make()
