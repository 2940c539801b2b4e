"""What a participant sees beside the editing page: consent, clock of a task, questionnaire, closing question.

The server is viser's; only its panel is used.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from kit1000.editor.session import part_name
from kit1000.study.plan import CONDITIONS
from kit1000.study.questionnaire import CONSENT, PREFERENCE, SCALES, UNSET, VALUES
from kit1000.study.records import Ratings

FAREWELL_S = 3.0  # [s] for which the last page stays


def ask_consent(server: Any) -> None:
    """Show the consent; returns when it is given."""
    gui = _dressed(server)
    gui.add_markdown(f"## User study\n\n{CONSENT}")
    agrees = gui.add_checkbox("I have read this, and take part", False)
    _wait_for(gui, "Begin", [agrees], lambda: bool(agrees.value))


def ask_ratings(server: Any, condition: str) -> Ratings:
    """Show the six scales; returns their ratings when all are set. Nothing is preset."""
    gui = _dressed(server)
    gui.add_markdown(f"## {condition}\n\nHow was it? Rate each from 0 to 100, in steps of 5.")
    lists = []
    for scale in SCALES:
        gui.add_markdown(f"**{scale.title}** {scale.question} *0: {scale.low.lower()}, 100: {scale.high.lower()}*")
        lists.append(gui.add_dropdown(scale.title, (UNSET, *map(str, VALUES)), initial_value=UNSET))
    _wait_for(gui, "Submit", lists, lambda: all(each.value != UNSET for each in lists))
    return Ratings(*(int(each.value) for each in lists))


def ask_preference(server: Any, conditions: Sequence[str]) -> str:
    """Show the closing question; returns the condition that is preferred."""
    gui = _dressed(server)
    labels = {CONDITIONS[name].label: name for name in conditions}
    gui.add_markdown(f"## Last question\n\n{PREFERENCE}")
    answer = gui.add_dropdown("Answer", (UNSET, *labels), initial_value=UNSET)
    _wait_for(gui, "Submit", [answer], lambda: answer.value != UNSET)
    return labels[answer.value]


def say_goodbye(server: Any) -> None:
    """The last page."""
    gui = server.gui
    gui.reset()
    gui.add_markdown("## Thank you\n\nYou have finished. You may close this page.")
    server.flush()
    time.sleep(FAREWELL_S)


class TaskPanel:
    """The clock and the buttons of a task, in the panel of the editing page."""

    def __init__(self, server: Any, title: str, one_part_an_upload: bool, request: Callable[[str], None]) -> None:
        """request: called with `upload` or `finish`."""
        self._server, gui = server, server.gui
        self._note = ""
        with gui.add_folder("Task", order=-1):
            gui.add_markdown(f"**{title}**")
            self._text = gui.add_markdown("")
            if not one_part_an_upload:
                gui.add_button("Upload", color="blue").on_click(lambda _: request("upload"))
            gui.add_button("Finish task", color="gray").on_click(lambda _: request("finish"))

    def wait_for_somebody(self) -> None:
        """Until the page is open."""
        while not self._server.get_clients():
            time.sleep(0.05)

    def note(self, text: str) -> None:
        """Say something below the clock."""
        self._note = text
        self._text.content = text
        self._server.flush()

    def show(self, left: float | None, outcomes: Mapping[int, str]) -> None:
        """Show the seconds left to upload in, None without a clock, and what became of parts."""
        clock = "no clock" if left is None else f"{int(left) // 60}:{int(left) % 60:02d} left to upload"
        lines = [clock, *(f"{part_name(part)}: {outcome}" for part, outcome in sorted(outcomes.items()))]
        text = "\n\n".join(filter(None, [*lines, self._note]))
        if self._text.content != text:
            self._text.content = text


def _dressed(server: Any) -> Any:
    server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="large")
    return server.gui


def _wait_for(gui: Any, label: str, inputs: Sequence[Any], ready: Callable[[], bool]) -> None:
    """A button that stays shut until the answers are there; returns when it is pressed."""
    button, pressed = gui.add_button(label, disabled=True, color="blue"), threading.Event()

    def changed(_: Any) -> None:
        button.disabled = not ready()

    def clicked(_: Any) -> None:
        if ready():
            pressed.set()

    for each in inputs:
        each.on_update(changed)
    button.on_click(clicked)
    pressed.wait()
