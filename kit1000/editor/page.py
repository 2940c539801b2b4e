"""The page, by viser: the only module that knows it. See `display` for what it shows and `controller` for why."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import viser
from numpy.typing import ArrayLike

from kit1000.editor import texts
from kit1000.editor.display import FIELD, NARROW, body_node
from kit1000.editor.dragging import NAMES, Modifier
from kit1000.editor.keys import Interface, Key, buttons_of, help_text, keys_of
from kit1000.editor.pointing import Eye
from kit1000.editor.texts import Colour
from kit1000.errors import Kit1000Error
from kit1000.mesh import Mesh
from kit1000.pose import Pose
from kit1000.sim.layout import TABLE_SIZE

if TYPE_CHECKING:
    from kit1000.editor.controller import Controller
    from kit1000.editor.label_page import LabelPage

    Actor = Controller | LabelPage
    """Who takes the events of a page."""

PLACES = ("head", "parts", "fit", "note")
SKY, SUN = 1.2, 1.9  # lights, by which cavities stand out without shadows
SUN_AT = (-0.6, -0.5, 1.0)
SAME_SHAPE = 0.02  # of two windows, in width over height
POINT_SIZE = 1.6e-3  # [m]: neighbours just touch
BELOW = 5e-4  # [m] z = 0, of the table's top: what stands on it is not cut
GIZMO = "/gizmo"
WATCHES = "Another tab of this page is in charge. When that is closed, this one is."


@dataclass(frozen=True)
class Panel:
    """What the panel beside the scene contains."""

    help: str  # in Markdown
    buttons: Mapping[str, Mapping[str, str]]  # verbs by the text of their buttons, in named groups
    keys: Sequence[Key] = ()
    field: str = ""  # name of a text field, if there is one

    @classmethod
    def of_editor(cls, interface: Interface, snaps: bool) -> Panel:
        """The panel of the editor. snaps: whether a method proposes fits."""
        return cls(help_text(interface, snaps), buttons_of(interface, snaps), keys_of(interface, snaps))


class ViserStage:
    """A page with a scene and a panel, and the events for an actor; tests have one of dictionaries."""

    def __init__(self, server: viser.ViserServer, panel: Panel, table: np.ndarray | None = None) -> None:
        """A page. table: (k, 2) [m] convex outline of the table; None: the simulated one."""
        self.server, self._table = server, table
        self._nodes: dict[str, Any] = {}
        self._labels: dict[str, Any] = {}
        self._texts: dict[str, Any] = {}
        self._actor: Actor | None = None
        self._acting: int | None = None
        self._aspect = NARROW
        self._clients: list[int] = []
        self._notices: dict[int, Any] = {}
        """Notices of the tabs that only watch."""
        self._dress(panel)

    def listen(self, actor: Actor) -> None:
        """Send the events of the page to an actor."""
        self._actor = actor
        for body in actor.bodies:
            self._listen_to(body_node(body))
        self.server.on_client_connect(self._joined)
        self.server.on_client_disconnect(self._left)

    # What a scene and a panel show.

    def show(self, name: str, mesh: Mesh, colour: Colour, opacity: float | None) -> None:
        """Add a mesh [m] of the world, at rest, or show another one under its name; opacity None: opaque."""
        self._nodes[name] = self.server.scene.add_mesh_simple(
            name,
            mesh.vertices.astype(np.float32),
            mesh.faces.astype(np.uint32),
            color=colour,
            opacity=opacity,
            flat_shading=True,
            side="double",
            cast_shadow=False,
            receive_shadow=False,
        )
        self._listen_to(name)

    def dots(self, name: str, points: np.ndarray, colours: np.ndarray) -> None:
        """Add points (n, 3) [m] of the world, at rest, in colours (n, 3) uint8."""
        self._nodes[name] = self.server.scene.add_point_cloud(
            name,
            points.astype(np.float32),
            colours,
            point_size=POINT_SIZE,
            point_shape="circle",
            precision="float32",
            point_shading="flat",
        )

    def move(self, name: str, motion: Pose) -> None:
        """Move a mesh or points by a motion of the world from where they were added."""
        handle = self._nodes[name]
        handle.wxyz, handle.position = motion.wxyz, motion.xyz

    def look(self, name: str, colour: Colour | None = None, visible: bool | None = None) -> None:
        """Change the colour of a mesh; hide or show a mesh or points."""
        handle = self._nodes[name]
        if colour is not None and tuple(handle.color) != colour:
            handle.color = colour
        if visible is not None and handle.visible != visible:
            handle.visible = visible

    def label(self, name: str, text: str, point: ArrayLike) -> None:
        """Write at a point (3,) [m] of the world; an empty text removes the label."""
        label = self._labels.get(name)
        if label is None:
            label = self.server.scene.add_label(f"/label{name}", text, anchor="bottom-center")
            self._labels[name] = label
        if text and label.text != text:
            label.text = text
        label.position = np.asarray(point, float)
        if label.visible != bool(text):
            label.visible = bool(text)

    def say(self, place: str, text: str) -> None:
        """Write Markdown into a place of the panel: head, parts, fit or note."""
        handle = self._texts[place]
        if handle.content != text:
            handle.content = text

    def progress(self, share: float) -> None:
        """How much of the background work is done, 0 to 1; the bar goes when all is done."""
        self._progress.value = 100 * share
        self._progress.visible = share < 1

    def gizmo(self, pose: Pose | None) -> None:
        """Show the gizmo at a pose, or hide it."""
        if pose is not None and not self._dragging_gizmo:
            self._gizmo.wxyz, self._gizmo.position = pose.wxyz, pose.xyz
        if self._gizmo.visible != (pose is not None):
            self._gizmo.visible = pose is not None

    def look_from(self, eye: ArrayLike, target: ArrayLike) -> None:
        """Put the camera of every tab, and of those to come, to a point (3,) [m], looking at another."""
        camera = self.server.initial_camera
        camera.position, camera.look_at = np.asarray(eye, float), np.asarray(target, float)
        for client in self.server.get_clients().values():
            client.camera.position, client.camera.look_at = np.asarray(eye, float), np.asarray(target, float)

    def flush(self) -> None:
        """Send all this now."""
        self.server.flush()

    # The page itself.

    def _dress(self, panel: Panel) -> None:
        server, gui = self.server, self.server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="small")
        gui.main_panel.dock_right()
        server.initial_camera.fov, server.initial_camera.near, server.initial_camera.far = FIELD, 0.02, 10.0
        server.initial_camera.up = (0.0, 0.0, 1.0)
        server.scene.set_up_direction("+z")
        server.scene.configure_default_lights(enabled=False)
        server.scene.configure_environment_map(None)
        server.scene.add_light_ambient("/light/sky", intensity=SKY)
        server.scene.add_light_directional("/light/sun", intensity=SUN, position=SUN_AT)
        self._lay_table()
        self._gizmo = server.scene.add_transform_controls(GIZMO, scale=0.06, visible=False, depth_test=False)
        self._gizmo.on_update(self._gizmo_moved)
        self._dragging_gizmo = False
        self._texts["head"] = gui.add_markdown("")
        self._progress = gui.add_progress_bar(0.0, animated=False, visible=False)
        for place in PLACES[1:]:
            self._texts[place] = gui.add_markdown("")
        self._field = gui.add_text(panel.field, "", visible=bool(panel.field))
        for label, verbs in panel.buttons.items():
            gui.add_button_group(label, tuple(verbs)).on_click(partial(self._group_clicked, verbs))
        with gui.add_folder("Help"):
            gui.add_markdown(panel.help)
        for key in panel.keys:
            label = key.help or key.verb.replace("-", " ")
            command = gui.add_command(label, hotkey=key.key, modifier=key.modifier)  # type: ignore[arg-type]
            command.on_trigger(partial(self._key_pressed, key.verb))

    @property
    def entered(self) -> str:
        """The text in the field of the panel."""
        return self._field.value

    @entered.setter
    def entered(self, text: str) -> None:
        self._field.value = text

    def _lay_table(self) -> None:
        """The simulated table, or as much of the user's own as was seen."""
        if self._table is None:
            width, depth, thickness = TABLE_SIZE
            at = (0, 0, -thickness / 2 - BELOW)
            sides = (width, depth, thickness)
            self.server.scene.add_box(
                "/table", texts.TABLE_COLOUR, sides, position=at, cast_shadow=False, receive_shadow=False
            )
        elif len(self._table) >= 3:
            corners = np.column_stack([self._table, np.full(len(self._table), -BELOW)]).astype(np.float32)
            others = np.arange(1, len(corners) - 1, dtype=np.uint32)
            faces = np.stack([np.zeros_like(others), others, others + 1], axis=-1)
            self.server.scene.add_mesh_simple(
                "/table",
                corners,
                faces,
                color=texts.TABLE_COLOUR,
                side="double",
                flat_shading=True,
                cast_shadow=False,
                receive_shadow=False,
            )

    def _listen_to(self, name: str) -> None:
        """Send what is done to a body to the actor."""
        actor, handle = self._actor, self._nodes[name]
        body = None if actor is None else next((each for each in actor.bodies if body_node(each) == name), None)
        if actor is None or body is None:
            return
        for modifier in NAMES if actor.drags else ():
            handle.on_drag("left", modifier=modifier)(partial(self._dragged, body, modifier))
        handle.on_click(partial(self._clicked, body))

    # Events. They are coroutines without an await: viser runs these in order, one after another.

    async def _joined(self, client: viser.ClientHandle) -> None:
        self._clients.append(client.client_id)
        self._choose_actor()
        client.camera.on_update(self._framed)
        if client.client_id != self._acting:
            self._notices[client.client_id] = client.add_notification("This tab only watches", WATCHES)

    async def _left(self, client: viser.ClientHandle) -> None:
        if client.client_id in self._clients:
            self._clients.remove(client.client_id)
        self._notices.pop(client.client_id, None)
        self._choose_actor()

    async def _framed(self, camera: viser.CameraHandle) -> None:
        actor, client = self._actor, camera.client
        if actor is None or client.client_id != self._acting or abs(camera.aspect / self._aspect - 1) < SAME_SHAPE:
            return
        self._aspect = camera.aspect
        actor.framed(eye_of(client))

    def _choose_actor(self) -> None:
        """The tab that came first acts; the others watch."""
        self._acting = self._clients[0] if self._clients else None
        notice = None if self._acting is None else self._notices.pop(self._acting, None)
        if notice is not None:
            notice.remove()

    def _call(self, event: Any, action: Callable[[Actor], object]) -> None:
        """Call the actor if the event comes from the tab in charge; the page shows errors."""
        if self._actor is None or event.client_id != self._acting:
            return
        try:
            action(self._actor)
        except (Kit1000Error, OSError) as error:  # such as a full disk: what is not written is not done
            self.say("note", f"**{texts.plain(str(error))}**")
            self.flush()

    async def _dragged(self, body: int, modifier: Modifier, event: Any) -> None:
        start, end = _screen(event.start_screen_pos), _screen(event.end_screen_pos)
        if event.phase == "start":
            grabbed = np.array(event.start_position, float)
            self._call(event, lambda actor: actor.grab(body, eye_of(event.client), start, grabbed, modifier))
        else:
            self._call(event, lambda actor: actor.drag(end))
        if event.phase == "end":
            self._call(event, lambda actor: actor.release())

    async def _clicked(self, body: int, event: Any) -> None:
        self._call(event, lambda actor: actor.select(body))

    async def _gizmo_moved(self, event: Any) -> None:
        handle, done = Pose(np.array(event.target.wxyz), np.array(event.target.position)), event.phase == "end"
        if event.client_id == self._acting:
            self._dragging_gizmo = not done
        self._call(event, lambda actor: actor.carry(handle, done))

    async def _key_pressed(self, verb: str, event: Any) -> None:
        self._call(event, lambda actor: actor.command(verb, eye_of(event.client)))

    async def _group_clicked(self, verbs: Mapping[str, str], event: Any) -> None:
        self._call(event, lambda actor: actor.command(verbs[event.target.value], eye_of(event.client)))


def eye_of(client: viser.ClientHandle) -> Eye:
    """The camera of a tab."""
    camera = client.camera
    return Eye(Pose(camera.wxyz, camera.position), float(camera.fov), float(camera.aspect))


def _screen(position: Any) -> tuple[float, float]:
    return float(position[0]), float(position[1])
