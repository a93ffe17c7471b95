#!/usr/bin/env python3
"""Writes rosbag2.db3, a bag of ROS 2 in SQLite, by the library `rosbags`. Needs: pip install rosbags==0.11.9 numpy pillow. Run in this folder.

Events: event k at 1,700,000,000 s + 1 ms + 37 us * k, column 7 k mod 32, row 5 k mod 24, ON where k is divisible by 3; ten to a message.
Pictures of 8 x 6: /cam/image_raw (mono8) value 8 y + x + 10 m in message m; /cam/colour/compressed (JPEG of quality 95, by Pillow) red 200, green 100, blue 50.
"""

import io
import shutil
import sqlite3
from pathlib import Path

import numpy as np
from PIL import Image
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

EPOCH = 1_700_000_000_000_000_000
store = get_typestore(Stores.ROS2_HUMBLE)
types = get_types_from_msg("uint16 x\nuint16 y\nbuiltin_interfaces/Time ts\nbool polarity", "dvs_msgs/msg/Event")
types |= get_types_from_msg("std_msgs/Header header\nuint32 height\nuint32 width\nEvent[] events", "dvs_msgs/msg/EventArray")
store.register(types)
T = store.types


def time(ns):
    return T["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)


def header(ns):
    return T["std_msgs/msg/Header"](stamp=time(ns), frame_id="cam")


def events(part):
    make = T["dvs_msgs/msg/Event"]
    return [make(x=7 * k % 32, y=5 * k % 24, ts=time(EPOCH + 10**6 + 37_000 * k), polarity=k % 3 == 0) for k in part]


folder = Path("rosbag2_made")
shutil.rmtree(folder, ignore_errors=True)
with Writer(folder, version=8, storage_plugin=StoragePlugin.SQLITE3) as writer:
    add = lambda name, kind: writer.add_connection(name, kind, typestore=store)
    of_events, raw, colour = add("/dvs/events", "dvs_msgs/msg/EventArray"), add("/cam/image_raw", "sensor_msgs/msg/Image"), add("/cam/colour/compressed", "sensor_msgs/msg/CompressedImage")
    jpeg = io.BytesIO()
    Image.new("RGB", (8, 6), (200, 100, 50)).save(jpeg, "jpeg", quality=95)
    for m in range(4):
        t = EPOCH + 10**6 * (m + 2)
        write = lambda connection, message: writer.write(connection, t, store.serialize_cdr(message, connection.msgtype))
        write(of_events, T["dvs_msgs/msg/EventArray"](header=header(t), height=24, width=32, events=events(range(10 * m, 10 * m + 10))))
        values = (8 * np.arange(6)[:, None] + np.arange(8) + 10 * m).astype(np.uint8).ravel()
        write(raw, T["sensor_msgs/msg/Image"](header=header(t - 500_000), height=6, width=8, encoding="mono8", is_bigendian=0, step=8, data=values))
        data = np.frombuffer(jpeg.getvalue(), np.uint8)
        write(colour, T["sensor_msgs/msg/CompressedImage"](header=header(t - 500_000), format="rgb8; jpeg compressed bgr8", data=data))
shutil.move(folder / "rosbag2_made.db3", "rosbag2.db3")
shutil.rmtree(folder)
# Pages of 1 KiB instead of 4 make the file small.
database = sqlite3.connect("rosbag2.db3", isolation_level=None)
database.execute("PRAGMA page_size = 1024")
database.execute("VACUUM")
