#!/usr/bin/env python3
"""Runs the commands of README.md, and of the tutorial, in the order in which a reader would: run.py [--only readme|tutorial]
[--program FILE]

The README's lines run exactly as they are printed, in an empty folder. Those of the tutorial run in another one, with smaller
numbers where SMALLER says so. Commands that take long are stopped as by Ctrl-C after `--limit` seconds: they must exit with
75, and go on when they start again. Every other command must exit with 0, and leave the files that the page promises. Needs
only the Python standard library; the Python blocks need a Python with the wheel (`--python`)."""

import argparse
import json
import os
import re
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import time
import zlib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TUTORIAL = ["first-dataset", "first-training", "own-scene", "own-method"]
STOPPED = 75

# Files in the folder after -o, or that file itself, by the command's first words.
PROMISED = {
    "demo": ["report/index.html"],
    "render": ["frame.0000.exr", "frame.0000.png", "sheet.png", "scene.json"],
    "dataset plan": [""],
    "dataset preview": ["*.png"],
    "dataset render": [
        "*/seq-000000/" + name for name in ("frame.0000.exr", "scene.json", "transforms.json", "env.hdr", "sequence.json")
    ],
    "dataset pack": ["manifest.json", "train-000000.tar"],
    "dataset stats": ["stats.html"],
    "train": ["checkpoint.safetensors", "log.jsonl"],
    "infer": ["**/*.png"],
    "evaluate": ["results.json"],
    "report": ["index.html"],
    "testset make": ["synthetic/*/seq-*"],
    "compose": [""],
}

# What the tutorial's commands are replaced by, so that the pages take minutes: (command, pattern, replacement).
SMALLER = [
    (
        "dataset plan",
        r"--sequences \d+ --frames \d+ --resolution 192 --spp 64",
        "--sequences 10 --frames 2 --resolution 64 --spp 4",
    ),
    (
        "dataset plan",
        r"--sequences 6 --frames 17 --frame-step 8 --resolution 256 --spp 128",
        "--sequences 2 --frames 2 --frame-step 8 --resolution 64 --spp 4",
    ),
    ("render", r"--resolution 1280x720", "--resolution 160x90"),
    ("evaluate", r"mine/ sets/synthetic", "mine/ data/test"),
    ("evaluate", r"--every 16", "--every 1"),
]
LONG = ("train", "testset make")


def blocks(page):
    """Language and text of the fenced blocks of a page."""
    return re.findall(r"(?ms)^```(\w+)\n(.*?)^```$", page.read_text(encoding="utf-8"))


def commands(text):
    """The commands of a block; a backslash joins lines."""
    return [line for line in text.replace("\\\n", "\\\0").splitlines() if line.strip()]


def words(command):
    """The subcommand, such as "dataset plan"."""
    found = [word for word in command.split()[1:3] if not word.startswith("-")]
    two = " ".join(found[:2])
    return two if two in PROMISED or found[0] in ("dataset", "testset") else found[0]


def model(path):
    """A textured box as a GLB, with the camera Front and the animation Walk."""
    corners = [(x, y, z) for x in (-0.5, 0.5) for y in (0.0, 1.0) for z in (-0.5, 0.5)]
    sides = [
        ((1, 0, 0), (4, 6, 7, 5)),
        ((-1, 0, 0), (0, 1, 3, 2)),
        ((0, 1, 0), (2, 3, 7, 6)),
        ((0, -1, 0), (0, 4, 5, 1)),
        ((0, 0, 1), (1, 5, 7, 3)),
        ((0, 0, -1), (0, 2, 6, 4)),
    ]
    positions = b"".join(struct.pack("<3f", *corners[i]) for _, side in sides for i in side)
    normals = b"".join(struct.pack("<3f", *normal) * 4 for normal, _ in sides)
    places = struct.pack("<8f", 0, 0, 1, 0, 1, 1, 0, 1) * 6
    indices = b"".join(struct.pack("<6H", *(4 * i + j for j in (0, 1, 2, 0, 2, 3))) for i in range(6))

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    rows = b"".join(b"\0" + b"".join(b"\xd0\x60\x30" if (x + y) % 2 else b"\xf0\xe8\xd8" for x in range(8)) for y in range(8))
    png = (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", struct.pack(">2I5B", 8, 8, 8, 2, 0, 0, 0))
        + chunk(b"IDAT", zlib.compress(rows))
        + chunk(b"IEND", b"")
    )
    # The box rises by a tenth in a quarter of a second.
    times, heights = struct.pack("<2f", 0, 0.25), struct.pack("<6f", 0, 0, 0, 0, 0.1, 0)
    parts, views, binary = [positions, normals, places, indices, png, times, heights], [], b""
    for part in parts:
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(part)})
        binary += part + b"\0" * (-len(part) % 4)
    description = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0, 1]}],
        "nodes": [{"mesh": 0, "name": "box"}, {"name": "Front", "camera": 0, "translation": [0, 0.5, 3]}],
        "cameras": [{"type": "perspective", "perspective": {"yfov": 0.7, "aspectRatio": 16 / 9, "znear": 0.1}}],
        "animations": [
            {
                "name": "Walk",
                "samplers": [{"input": 4, "output": 5}],
                "channels": [{"sampler": 0, "target": {"node": 0, "path": "translation"}}],
            }
        ],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2}, "indices": 3, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicFactor": 0, "roughnessFactor": 0.4}}],
        "textures": [{"source": 0}],
        "images": [{"bufferView": 4, "mimeType": "image/png"}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 24, "type": "VEC3", "min": [-0.5, 0, -0.5], "max": [0.5, 1, 0.5]},
            {"bufferView": 1, "componentType": 5126, "count": 24, "type": "VEC3"},
            {"bufferView": 2, "componentType": 5126, "count": 24, "type": "VEC2"},
            {"bufferView": 3, "componentType": 5123, "count": 36, "type": "SCALAR"},
            {"bufferView": 5, "componentType": 5126, "count": 2, "type": "SCALAR", "min": [0], "max": [0.25]},
            {"bufferView": 6, "componentType": 5126, "count": 2, "type": "VEC3"},
        ],
        "bufferViews": views,
        "buffers": [{"byteLength": len(binary)}],
    }
    text = json.dumps(description).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    path.write_bytes(struct.pack("<4s2I", b"glTF", 2, 12 + len(body)) + body)


def capture(path):
    """Two cameras around the box, as nerfstudio writes them."""
    frames = []
    for x in (0.0, 0.3):
        matrix = [[1, 0, 0, x], [0, 1, 0, 0.5], [0, 0, 1, 3], [0, 0, 0, 1]]
        frames.append({"file_path": f"images/{len(frames)}.png", "transform_matrix": matrix})
    path.parent.mkdir(exist_ok=True)
    path.write_text(json.dumps({"fl_x": 200, "fl_y": 200, "cx": 80, "cy": 45, "w": 160, "h": 90, "frames": frames}))


class Reader:
    """Somebody who types what a page says, in one folder."""

    def __init__(self, options, folder, environment):
        self.options, self.folder, self.environment, self.faults = options, folder, environment, []

    def pictures(self):
        """The folder `mine`, in which the reader's own renderer has rendered the test split of the first page's dataset."""
        for frame in (self.folder / "data/test").rglob("frame.*.exr"):
            mine = self.folder / "mine" / frame.parent.name / frame.name.replace("frame.00", "out_")
            mine.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(frame, mine)

    def fault(self, what):
        print(f"    FAILED: {what}", flush=True)
        self.faults.append(what)

    def start(self, command, limit):
        """Exit status and output. After `limit` seconds it gets the signal of Ctrl-C."""
        with tempfile.TemporaryFile("w+", errors="replace") as log:
            process = subprocess.Popen(
                ["bash", "-c", command], cwd=self.folder, env=self.environment, stdout=log, stderr=log, start_new_session=True
            )
            try:
                process.wait(limit)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGINT)
                try:
                    process.wait(300)
                except subprocess.TimeoutExpired:
                    os.killpg(process.pid, signal.SIGKILL)
                    process.wait()
            log.seek(0)
            return process.returncode, log.read()

    def run(self, command, printed):
        print(f"$ {command.replace(chr(92) + chr(0), chr(92) + chr(10))}", flush=True)
        if command != printed:
            print(f"    (smaller than on the page: {printed})")
        command = command.replace("\\\0", "\\\n")
        began = time.monotonic()
        kind = words(command)
        stopped = 0
        if kind in LONG:
            for attempt in range(2):
                status, output = self.start(command, self.options.limit)
                stopped += status == STOPPED
                if status == 0:
                    break
                if status != STOPPED:
                    self.fault(f"{command}: exit code {status} after Ctrl-C, attempt {attempt + 1}\n{output[-1500:]}")
                    return
        else:
            status, output = self.start(command, self.options.patience)
            if status != 0:
                self.fault(f"{command}: exit code {status}\n{output[-1500:]}")
                return
        # The last word without an option is the folder where a command has no -o.
        bare = command.split("#")[0]
        out = re.search(r" (?:-o|--out|>) (\S+)", bare)
        out = self.folder / (out.group(1) if out else bare.split()[-1])
        missing = [name for name in PROMISED.get(kind, []) if not (list(out.glob(name)) if name else out.is_file())]
        if missing and not stopped:
            self.fault(f"{command}: {out.name} lacks {', '.join(name or 'the file itself' for name in missing)}")
        print(
            f"    {time.monotonic() - began:.0f} s" + (f", stopped {stopped} times with exit code {STOPPED}" if stopped else ""),
            flush=True,
        )

    def python(self, code):
        print("python: " + code.strip().splitlines()[0] + " ...", flush=True)
        found = subprocess.run([self.options.python, "-c", "import renderflow"], capture_output=True, env=self.environment)
        torch = (
            "torch" not in code
            or subprocess.run([self.options.python, "-c", "import torch"], capture_output=True).returncode == 0
        )
        if found.returncode or not torch:
            print(f"    skipped: {self.options.python} has no {'renderflow' if found.returncode else 'torch'}")
            return
        done = subprocess.run(
            [self.options.python, "-c", code], cwd=self.folder, env=self.environment, capture_output=True, text=True
        )
        if done.returncode:
            self.fault(f"a block of Python: {done.stderr[-1500:]}")

    def page(self, page, smaller=()):
        print(f"\n{page.relative_to(ROOT)}", flush=True)
        for language, text in blocks(page):
            if language == "python":
                self.python(text)
            if language == "json":
                (self.folder / "printed.json").write_text(text)
                self.run("renderflow check printed.json", "renderflow check printed.json")
            for printed in commands(text) if language == "sh" else []:
                if not printed.startswith("renderflow "):
                    if self.options.build:
                        status, output = self.start(f"cd {ROOT} && {printed}", 3600)
                        status and self.fault(f"{printed}: exit code {status}\n{output[-1500:]}")
                    else:
                        print(f"skipped, for it builds or sets the path (--build runs it): {printed}")
                    continue
                command = printed
                for kind, pattern, replacement in smaller:
                    if words(printed) == kind:
                        command = re.sub(pattern, replacement, command)
                weights = re.search(r" --weights (\S+)", command)
                if weights and smaller and not (self.folder / weights[1]).exists():
                    print(f"    the training was stopped before it wrote {weights[1]}")
                    command = command.replace(weights[0], "")
                self.run(command, printed)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--program", type=Path, default=ROOT / "target/release/renderflow")
    parser.add_argument("--python", default=str(ROOT / "target/python-wheel-test/bin/python"))
    parser.add_argument("--only", choices=["readme", "tutorial"])
    parser.add_argument("--build", action="store_true", help="also run the lines that build")
    parser.add_argument("--limit", type=float, default=60, help="seconds after which long commands are stopped")
    parser.add_argument("--patience", type=float, default=1800, help="seconds that any other command may take")
    options = parser.parse_args()
    options.python = os.path.abspath(options.python)  # Not resolved: a link is how an environment names itself.
    if not Path(options.python).exists():
        options.python = sys.executable
    faults = []
    with tempfile.TemporaryDirectory() as temporary:
        temporary = Path(temporary)
        tools = temporary / "bin"
        tools.mkdir()
        (tools / "renderflow").symlink_to(options.program.resolve())
        # What `--open` starts.
        (tools / "xdg-open").write_text('#!/bin/sh\ntest -e "$1"\n')
        (tools / "xdg-open").chmod(0o755)
        environment = {**os.environ, "PATH": f"{tools}:{os.environ['PATH']}"}
        for name in ("readme", "tutorial"):
            if options.only not in (None, name):
                continue
            folder = temporary / name
            folder.mkdir()
            model(folder / "model.glb")
            capture(folder / "capture/transforms.json")
            shutil.copy(ROOT / "hdri/clear_afternoon.hdr", folder / "sky.hdr")
            reader = Reader(options, folder, environment)
            if name == "readme":
                reader.page(ROOT / "README.md")
            else:
                for page in TUTORIAL:
                    if page == "own-method":
                        reader.pictures()
                    reader.page(ROOT / f"docs/tutorial/{page}.md", SMALLER)
            faults += reader.faults
    print(f"\n{len(faults)} failed" + "".join(f"\n- {fault.splitlines()[0]}" for fault in faults))
    sys.exit(bool(faults))


if __name__ == "__main__":
    main()
