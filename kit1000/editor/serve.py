"""Serves the page to this machine alone, and runs an editing session from the first line to Ctrl-C.

viser names no allowed origins: any web page that the person has open could connect, read the scene and act. The
handshake therefore demands the Origin of this page, before anything is sent. No name of a file or module ever comes
from the browser.
"""

from __future__ import annotations

import contextlib
import io
import os
import socket
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
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
from kit1000.editor.worker import Completion, Method, Worker
from kit1000.errors import InputError, InternalError, shown
from kit1000.files import check_writable, locked
from kit1000.interrupts import wait_until_interrupted
from kit1000.perception.sensor_facts import SensorFacts, sensor_of
from kit1000.prediction.catalog import all_methods
from kit1000.values import SceneShapes

HOST = "127.0.0.1"
PORTS = range(8080, 8100)  # tried in order, if none is asked for
NO_SNAP = "none"
REFUSED = 403  # HTTP status of a handshake from another origin
MOST_REFUSED = 100  # addresses that are printed


@dataclass(frozen=True)
class Options:
    """What to edit, and how."""

    data: Path
    scene: str
    out: Path  # submission folder, which gets the confirmed parts and the log of events
    sensor: str = "ideal"
    snap: str = NO_SNAP  # `module:Object`, or none
    port: int | None = None
    truth: bool = False
    interface: Interface = "scene"
    base_from_camera: Path | None = None  # JSON file with the pose of the camera in the base of a robot, for moves.json
    shapes: SceneShapes | None = None  # the shapes in the image, for a method that reads them

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
        with serving(options.port) as (server, address):
            worker = None if options.snap == NO_SNAP else Worker(method, scene.parts)
            table = seen_table(dataset.summary, options.scene)
            stage = ViserStage(server, Panel.of_editor(options.interface, worker is not None), table)
            stage.say("head", head_text(header, camera_name(sensor_of(dataset.summary, options.sensor, options.scene))))
            controller = Controller(scene, stage, log, worker, moves)
            stage.listen(controller)
            log.add("open")
            try:
                if worker is not None:
                    worker.start(controller.received, None if options.truth else partial(_complete, controller))
                yield controller, address
            finally:
                if worker is not None:
                    worker.close()
                log.add("close")


def _complete(controller: Controller, completion: Completion) -> None:
    """Show the known shapes, and print which of them were not found."""
    controller.completed(completion)
    if controller.space.not_found:
        print(controller.space.not_found, file=sys.stderr)


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
        edits = space.part_edits.values()
        print(f"{options.out}: {sum(edit.confirmed for edit in edits)} of {len(edits)} parts confirmed")


@contextlib.contextmanager
def serving(port: int | None, title: str = "kit1000 edit") -> Iterator[tuple[viser.ViserServer, str]]:
    """A server for this machine alone, and its address. port: None for a free one. title: of the page."""
    chosen = _free_port() if port is None else port
    if not 0 < chosen < 1 << 16:
        raise InputError(f"--port: expected 1 to 65535, got {chosen}")
    os.environ.pop("_VISER_PORT_OVERRIDE", None)
    with _guarded(chosen) as calls, contextlib.redirect_stdout(io.StringIO()):
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
def _guarded(port: int) -> Iterator[list[int]]:
    """While the server is made, its handshake demands the Origin of its page; yields a list with the calls."""
    serve, calls, refused = websocket_server.serve, [], set[str]()
    origins = [f"http://{name}:{port}" for name in (HOST, "localhost")]

    def respond(connection: Any, request: Any, response: Any) -> None:
        response.headers["X-Frame-Options"] = "DENY"
        response.headers["Content-Security-Policy"] = "frame-ancestors 'none'"
        origin = shown(request.headers.get("Origin") or "no address")[:200]
        if response.status_code == REFUSED and origin not in refused and len(refused) < MOST_REFUSED:
            refused.add(origin)
            advice = f"forward the same port, ssh -L {port}:{HOST}:{port}"
            print(f"refused a page at {origin}: the server answers {', '.join(origins)}; {advice}", file=sys.stderr)

    def guarded(*args: Any, **options: Any) -> Any:
        calls.append(port)
        return serve(*args, **{**options, "origins": origins, "process_response": respond})

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
