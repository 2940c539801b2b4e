"""The web addresses whose page may talk to the server; another one gets a page that says why it stays empty."""

from __future__ import annotations

import gzip
import json
import re
import sys
from collections.abc import Sequence
from typing import Any

from kit1000.errors import InputError, shown

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
        self._told: set[str] = set()

    def process_response(self, connection: Any, request: Any, response: Any) -> None:
        """Forbid frames, tell a page at another address why it is empty, and the terminal which was refused."""
        response.headers["X-Frame-Options"] = "DENY"
        response.headers["Content-Security-Policy"] = "frame-ancestors 'none'"
        if response.status_code == REFUSED:
            self._tell(request.headers.get("Origin"))
        elif response.headers.get("Content-Type", "").startswith("text/html") and response.body:
            self._explain(response)

    def _explain(self, response: Any) -> None:
        """Put a script into a page that replaces it where it is open at another address."""
        packed = response.headers.get("Content-Encoding") == "gzip"
        page = gzip.decompress(response.body) if packed else response.body
        script = (SCRIPT % (json.dumps(self.origins), json.dumps(explanation(self.origins)))).encode()
        head = page.find(b"<head>") + len(b"<head>") if b"<head>" in page else 0
        page = page[:head] + script + page[head:]
        response.body = gzip.compress(page) if packed else page
        del response.headers["Content-Length"]
        response.headers["Content-Length"] = str(len(response.body))

    def _tell(self, origin: str | None) -> None:
        name = shown(origin or "no address")[:200]
        if name not in self._told and len(self._told) < 100:
            self._told.add(name)
            hint = f"; --origin {name} lets it in" if ORIGIN.match(name) else ""
            print(f"refused a page at {name}: the server answers {', '.join(self.origins)}{hint}", file=sys.stderr)
