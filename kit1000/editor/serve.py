"""Serves the page to this machine alone, and runs an editing session from the first line to Ctrl-C.

viser names no allowed origins: any web page that the person has open could connect, read the scene and act. The
handshake therefore demands the Origin of this page, before anything is sent. No name of a file or module ever comes
from the browser.
"""

from __future__ import annotations

import contextlib
import gzip
import io
import json
import os
import re
import socket
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

import viser
import websockets.asyncio.server as websocket_server

from kit1000.capture.camera_poses import check_base_pose
from kit1000.capture.pose_files import read_pose
from kit1000.dataset.own_scenes import seen_table
from kit1000.dataset.reader import Dataset
from kit1000.editor.controller import Controller
from kit1000.editor.keys import Interface
from kit1000.editor.page import Panel, ViserStage
from kit1000.editor.records import EventLog, Header, Sink
from kit1000.editor.scene import EditedScene
from kit1000.editor.worker import Method, Worker
from kit1000.errors import InputError, InternalError, shown
from kit1000.files import check_writable, locked
from kit1000.interrupts import wait_until_interrupted
from kit1000.perception.sensor_facts import SensorFacts, sensor_of
from kit1000.prediction.catalog import all_methods
from kit1000.values import SceneShapes

HOST = "127.0.0.1"
PORTS = range(8080, 8100)  # tried in order, if none is asked for
NO_SNAP = "none"
ORIGIN = re.compile(r"https?://[a-zA-Z0-9.\-]+(:\d{1,5})?\Z|https?://\[[0-9a-fA-F:]+\](:\d{1,5})?\Z")
REFUSED = 403  # HTTP status of a handshake from another origin
SCRIPT = """<script>
(() => {
  const allowed = %s;
  if (allowed.includes(location.origin)) return;
  window.stop();
  const text = document.createElement("p");
  text.style.cssText = "font: 16px sans-serif; margin: 3em; max-width: 40em";
  text.textContent = %s.replaceAll("ORIGIN", location.origin);
  document.documentElement.replaceChildren(text);
})();
</script>"""


@dataclass(frozen=True)
class Options:
    """What to edit, and how."""

    data: Path
    scene: str
    out: Path
    """Submission folder, which gets the confirmed parts and the log of events."""
    sensor: str = "ideal"
    snap: str = NO_SNAP
    """`module:Object`, or none."""
    port: int | None = None
    truth: bool = False
    interface: Interface = "scene"
    origins: tuple[str, ...] = ()
    """Further web addresses whose page may talk to the server, such as http://localhost:9000."""
    base_from_camera: Path | None = None
    """JSON file with the pose of the camera in the base of a robot, for moves.json."""
    shapes: SceneShapes | None = None
    """The shapes in the image, for a method that reads them."""

    def __post_init__(self) -> None:
        if self.interface != "scene" and self.shapes is not None:
            raise InputError("known shapes: hand control shows what the camera saw; leave them out")
        if self.interface != "scene" and self.snap != NO_SNAP:
            raise InputError(f"--snap {self.snap}: nothing snaps in hand control; leave it out, or use --snap none")

    def header(self, dataset_id: str) -> Header:
        """The header of the log."""
        method = all_methods().get(self.snap)
        known = self.shapes is not None or (method is not None and method.reads == "shapes")
        return Header(dataset_id, self.scene, self.sensor, self.truth, self.snap, self.interface, known)


@contextlib.contextmanager
def editing(options: Options, sink: Sink | None = None, moves: bool = False) -> Iterator[tuple[Controller, str]]:
    """A page while the block runs: its controller and its address.

    sink: called with each event as the log has it, after it is written. moves: whether moves.json is written.
    """
    check_writable(options.out)
    dataset = Dataset(options.data)
    base = None if options.base_from_camera is None else read_pose(options.base_from_camera)
    scene = EditedScene.open(dataset, options.scene, options.sensor, options.truth, base)
    _report_base(scene, options.base_from_camera or dataset.root / "dataset.json")
    method = Method(options.snap, dataset.root, options.scene, options.sensor, options.truth, options.shapes)
    if options.snap != NO_SNAP:
        method.check()
    header = options.header(dataset.id)
    with locked(options.out):
        log = EventLog(options.out, header, sink=sink)
        with serving(options.port, options.origins) as (server, address):
            worker = None if options.snap == NO_SNAP else Worker(method, scene.parts)
            table = seen_table(dataset.summary, options.scene)
            stage = ViserStage(server, Panel.of_editor(options.interface, worker is not None), table)
            stage.say("head", head_text(header, camera_name(sensor_of(dataset.summary, options.sensor, options.scene))))
            controller = Controller(scene, stage, log, worker, moves)
            stage.listen(controller)
            log.add("open")
            try:
                if worker is not None:
                    worker.start(controller.received, controller.completed if controller.display.completes else None)
                yield controller, address
            finally:
                if worker is not None:
                    worker.close()
                log.add("close")


def _report_base(scene: EditedScene, stated: Path) -> None:
    """Print how the table lies in the base of a robot, if its pose is stated; refuse a pose that cannot be meant."""
    if scene.base_from_camera is not None:
        eye = scene.view.world_from_camera  # the table is at z = 0 of the world
        up = eye.inverse().rotate((0.0, 0.0, 1.0))
        for line in check_base_pose(scene.base_from_camera, up, float(eye.xyz[2]), str(stated)):
            print(line, file=sys.stderr)


def run(options: Options) -> None:
    """Serve the page until Ctrl-C."""
    with editing(options, moves=True) as (controller, address):
        with contextlib.suppress(KeyboardInterrupt):
            print(f"{address}  (Ctrl-C ends; everything is saved in {options.out})", flush=True)
            wait_until_interrupted()
        space = controller.space
        confirmed = sum(space.session.edits[part].confirmed for part in space.scene.parts)
        print(f"{options.out}: {confirmed} of {len(space.scene.parts)} parts confirmed")


@contextlib.contextmanager
def serving(
    port: int | None, origins: Sequence[str] = (), title: str = "kit1000 edit"
) -> Iterator[tuple[viser.ViserServer, str]]:
    """A server for this machine alone, and its address.

    port: None for a free one. origins: further web addresses whose page may talk to it, as behind a tunnel or a proxy.
    title: of the page.
    """
    check_origins(origins)
    chosen = _free_port() if port is None else port
    if not 0 < chosen < 1 << 16:
        raise InputError(f"--port: expected 1 to 65535, got {chosen}")
    os.environ.pop("_VISER_PORT_OVERRIDE", None)
    with _guarded(chosen, origins) as calls, contextlib.redirect_stdout(io.StringIO()):
        server = viser.ViserServer(host=HOST, port=chosen, label=title, verbose=False)
    try:
        if not calls:
            raise InternalError("viser no longer serves by websockets.asyncio.server.serve: its origins are unchecked")
        if server.get_port() != chosen:
            raise InputError(f"--port {chosen}: is taken by another program; choose another, or leave --port out")
        server.request_share_url = _refuse_to_share  # a client could ask for a public tunnel
        yield server, f"http://{HOST}:{chosen}"
    finally:
        with contextlib.redirect_stdout(io.StringIO()):  # viser reports it
            server.stop()


def camera_name(sensor: SensorFacts) -> str:
    """What the page calls the camera of an image."""
    return f"{sensor.device} camera" if sensor.simulated_table else sensor.device


def head_text(header: Header, camera: str) -> str:
    """The top of the panel. camera: its name."""
    seen = f"known shapes, as the {camera} saw them" if header.shapes else f"as the {camera} saw it"
    shown = "**TRUE SHAPES ARE SHOWN**" if header.truth else seen
    snap = "nothing snaps" if header.snap == NO_SNAP else f"snaps by {header.snap.rpartition(':')[2]}"
    return f"**{header.scene}** · {shown} · {snap}"


@contextlib.contextmanager
def _guarded(port: int, further: Sequence[str]) -> Iterator[list[int]]:
    """While the server is made, its handshake demands the Origin of its page; yields a list with the calls."""
    serve, calls = websocket_server.serve, []
    guard = Guard([*(f"http://{name}:{port}" for name in (HOST, "localhost")), *further])

    def guarded(*args: Any, **options: Any) -> Any:
        calls.append(port)
        return serve(*args, **{**options, "origins": guard.origins, "process_response": guard.process_response})

    with mock.patch.object(websocket_server, "serve", guarded):
        yield calls


def _refuse_to_share(verbose: bool = True) -> None:
    """No public address is ever made."""


def _free_port() -> int:
    """The first port of PORTS that nothing listens on, or any."""
    for port in (*PORTS, 0):
        with socket.socket() as probe, contextlib.suppress(OSError):
            probe.bind((HOST, port))
            return probe.getsockname()[1]
    raise InputError("no port is free")


def check_origins(origins: Sequence[str]) -> None:
    """Raise InputError for a web address that no browser would state."""
    for origin in origins:
        if not ORIGIN.match(origin):
            raise InputError(f"--origin {origin}: expected scheme, host and port, such as http://localhost:9000")


def explanation(origins: Sequence[str]) -> str:
    """Why a page at another address than `origins` stays empty, and how to let it in; ORIGIN stands for its address."""
    port = origins[0].rpartition(":")[2]
    return (
        f"This page stays empty: it is open at ORIGIN, and the server answers {' and '.join(origins)} alone. "
        f"Either forward the same port (ssh -L {port}:127.0.0.1:{port}), or start the command again with "
        "--origin ORIGIN."
    )


class Guard:
    """Looks at the responses of a server."""

    def __init__(self, origins: Sequence[str]) -> None:
        self.origins = list(origins)
        self._reported: set[str] = set()

    def process_response(self, connection: Any, request: Any, response: Any) -> None:
        """Forbid frames, explain to a page at another address why it is empty, and print which address was refused."""
        response.headers["X-Frame-Options"] = "DENY"
        response.headers["Content-Security-Policy"] = "frame-ancestors 'none'"
        if response.status_code == REFUSED:
            self._report(request.headers.get("Origin"))
        elif response.headers.get("Content-Type", "").startswith("text/html") and response.body:
            self._explain(response)

    def _explain(self, response: Any) -> None:
        """Put a script into a page that replaces it if it is open at another address."""
        packed = response.headers.get("Content-Encoding") == "gzip"
        page = gzip.decompress(response.body) if packed else response.body
        script = (SCRIPT % (json.dumps(self.origins), json.dumps(explanation(self.origins)))).encode()
        head = page.find(b"<head>") + len(b"<head>") if b"<head>" in page else 0
        page = page[:head] + script + page[head:]
        response.body = gzip.compress(page) if packed else page
        del response.headers["Content-Length"]
        response.headers["Content-Length"] = str(len(response.body))

    def _report(self, origin: str | None) -> None:
        name = shown(origin or "no address")[:200]
        if name not in self._reported and len(self._reported) < 100:
            self._reported.add(name)
            hint = f"; --origin {name} lets it in" if ORIGIN.match(name) else ""
            print(f"refused a page at {name}: the server answers {', '.join(self.origins)}{hint}", file=sys.stderr)
