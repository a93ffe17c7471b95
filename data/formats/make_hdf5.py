#!/usr/bin/env python3
"""Writes the small HDF5 files beside this script, as other programs write them.

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


if __name__ == "__main__":
    filters()
    dsec()
