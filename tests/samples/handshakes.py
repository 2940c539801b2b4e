"""Handshakes of a browser with the server of a page, from any web address."""

from __future__ import annotations

import asyncio

import viser
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidStatus

from kit1000.editor.serve import HOST

PROTOCOL = f"viser-v{viser.__version__}"


def shake(port: int, origin: str | None) -> int:
    """HTTP status of a handshake: 101 where it is accepted."""

    async def go() -> int:
        try:
            async with connect(f"ws://{HOST}:{port}", origin=origin, subprotocols=[PROTOCOL], proxy=None):  # type: ignore[arg-type, list-item]
                return 101
        except InvalidStatus as refused:
            return refused.response.status_code

    return asyncio.run(go())
