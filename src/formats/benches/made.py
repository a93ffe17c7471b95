#!/usr/bin/env python3
"""Writes the events of a recording in other formats, and frames, so that `peers.py` can compare readers on the same data.

    pip install numpy h5py hdf5plugin faery rosbags mcap opencv-python-headless
    python3 src/formats/benches/made.py EVENTS FOLDER

EVENTS is a file that faery reads. FOLDER gets: DSEC's HDF5 layout with deflate, with blosc and zstd, and without compression; text with commas (a header, us)
and with blanks (seconds); npz, packed and not; a ROS 1 bag and an MCAP file with `dvs_msgs/EventArray` (1,000 events a message); 60 random frames of
640 x 480 as PNG (8 and 16 bits) and as Y4M.
"""

import os
import sys

import numpy as np

MESSAGE = 1000
HEADER = "std_msgs/Header header\nuint32 height\nuint32 width\ndvs_msgs/Event[] events\n"
EVENT = "uint16 x\nuint16 y\ntime ts\nbool polarity\n"


def events_of(path):
    import faery

    events = np.concatenate(list(faery.events_stream_from_file(path)))
    order = np.argsort(events["t"], kind="stable")
    t, x, y, on = (events[name][order] for name in ("t", "x", "y", "on"))
    return t.astype(np.int64), x.astype(np.uint16), y.astype(np.uint16), on.astype(np.uint8)


def hdf5(folder, t, x, y, on):
    import h5py
    import hdf5plugin

    kinds = {"plain": {}, "gzip": {"compression": "gzip", "compression_opts": 4}, "blosc_zstd": hdf5plugin.Blosc(cname="zstd", clevel=5), "zstd": hdf5plugin.Zstd()}
    for name, how in kinds.items():
        with h5py.File(f"{folder}/dsec_{name}.h5", "w") as file:
            for column, values in (("t", t - t[0]), ("x", x), ("y", y), ("p", on)):
                values = values.astype(np.uint32) if column == "t" else values
                file.create_dataset(f"events/{column}", data=values, chunks=(1 << 16,), **how)
            file["t_offset"] = np.int64(t[0])
            last = int(t[-1] - t[0]) // 1000
            file["ms_to_idx"] = np.searchsorted(t - t[0], 1000 * np.arange(last + 1)).astype(np.uint64)


def text(folder, t, x, y, on):
    with open(f"{folder}/events.csv", "w") as file:
        file.write("t_us,x,y,p\n")
        file.writelines(f"{a},{b},{c},{d}\n" for a, b, c, d in zip(t.tolist(), x.tolist(), y.tolist(), on.tolist()))
    with open(f"{folder}/events.txt", "w") as file:
        file.write("# t_s x y p\n")
        file.writelines(f"{a // 1_000_000}.{a % 1_000_000:06d} {b} {c} {d}\n" for a, b, c, d in zip(t.tolist(), x.tolist(), y.tolist(), on.tolist()))


def npz(folder, t, x, y, on):
    np.savez(f"{folder}/events_plain.npz", t=t, x=x, y=y, p=on)
    np.savez_compressed(f"{folder}/events_packed.npz", t=t, x=x, y=y, p=on)


def stamps(t):
    return (t // 1_000_000).astype(np.uint32), (t % 1_000_000 * 1000).astype(np.uint32)


def parts(t):
    return (slice(start, min(start + MESSAGE, len(t))) for start in range(0, len(t), MESSAGE))


def bag(folder, t, x, y, on):
    from rosbags.rosbag1 import Writer

    path = f"{folder}/events.bag"
    if os.path.exists(path):
        os.remove(path)
    width, height = int(x.max()) + 1, int(y.max()) + 1
    pack = lambda *values: np.array(values, "<u4").tobytes()
    head = lambda us, n: pack(0, us // 1_000_000, us % 1_000_000 * 1000, 3) + b"dvs" + pack(height, width, n)
    definition = HEADER + "=" * 80 + "\nMSG: dvs_msgs/Event\n" + EVENT + "=" * 80 + "\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
    event = np.dtype([("x", "<u2"), ("y", "<u2"), ("s", "<u4"), ("ns", "<u4"), ("p", "u1")])
    seconds, nanoseconds = stamps(t)
    with Writer(path) as writer:
        connection = writer.add_connection("/dvs/events", "dvs_msgs/msg/EventArray", msgdef=definition, md5sum="5e8beee5a6c107e504c2e78903c224b8")
        for part in parts(t):
            body = np.empty(part.stop - part.start, event)
            body["x"], body["y"], body["s"], body["ns"], body["p"] = x[part], y[part], seconds[part], nanoseconds[part], on[part]
            writer.write(connection, int(t[part.stop - 1]) * 1000, head(int(t[part.start]), len(body)) + body.tobytes())


def mcap(folder, t, x, y, on):
    from mcap.writer import Writer

    width, height = int(x.max()) + 1, int(y.max()) + 1
    pack = lambda *values: np.array(values, "<u4").tobytes()
    # CDR: four bytes of encapsulation, then fields at multiples of their size.
    head = lambda us, n: b"\0\1\0\0" + pack(us // 1_000_000, us % 1_000_000 * 1000, 4) + b"dvs\0" + pack(height, width, n)
    definition = HEADER + "=" * 80 + "\nMSG: dvs_msgs/Event\n" + EVENT.replace("time ts", "builtin_interfaces/Time ts")
    definition += "=" * 80 + "\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    definition += "=" * 80 + "\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
    seconds, nanoseconds = stamps(t)
    with open(f"{folder}/events.mcap", "wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="made")
        schema = writer.register_schema(name="dvs_msgs/msg/EventArray", encoding="ros2msg", data=definition.encode())
        channel = writer.register_channel(topic="/dvs/events", message_encoding="cdr", schema_id=schema)
        for part in parts(t):
            n = part.stop - part.start
            # Each field stands at a multiple of its own size: x and y of the first event at 0 and 2, of event k at 16 k - 2 and 16 k; the others at 16 k + 4, 8, 12.
            body = np.zeros(16 * n, np.uint8)
            words, longs = body.view("<u2"), body.view("<u4")
            longs[1::4], longs[2::4], body[12::16] = seconds[part], nanoseconds[part], on[part]
            words[8::8], words[7:-1:8] = y[part][1:], x[part][1:]
            words[0], words[1] = x[part][0], y[part][0]
            log_time = int(t[part.stop - 1]) * 1000
            data = head(int(t[part.start]), n) + body[:-3].tobytes()
            writer.add_message(channel_id=channel, log_time=log_time, publish_time=log_time, data=data)
        writer.finish()


def frames(folder):
    import cv2

    random = np.random.default_rng(7)
    grey = [cv2.GaussianBlur(random.integers(0, 65536, (480, 640)).astype(np.uint16), (0, 0), 3) for _ in range(60)]
    for bits in (8, 16):
        place = f"{folder}/png_{bits}"
        os.makedirs(place, exist_ok=True)
        for k, frame in enumerate(grey):
            cv2.imwrite(f"{place}/{k:06d}.png", frame if bits == 16 else (frame >> 8).astype(np.uint8))
        with open(f"{place}/timestamps.txt", "w") as file:
            file.write("# t_us\n" + "".join(f"{k * 10_000}\n" for k in range(60)))
    with open(f"{folder}/video.y4m", "wb") as file:
        file.write(b"YUV4MPEG2 W640 H480 F100:1 Ip A1:1 C420jpeg\n")
        for frame in grey:
            file.write(b"FRAME\n" + (frame >> 8).astype(np.uint8).tobytes() + b"\x80" * (320 * 240 * 2))


def main():
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    folder = sys.argv[2]
    os.makedirs(folder, exist_ok=True)
    columns = events_of(sys.argv[1])
    for write in (hdf5, text, npz, bag, mcap):
        write(folder, *columns)
    frames(folder)


if __name__ == "__main__":
    main()
