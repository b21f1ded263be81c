"""Widget of a notebook: the page in a frame, and a live scene that its sliders render anew in the notebook's kernel."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from ..errors import InputError, LidarSceneError
from ..files.optional import import_optional
from ..kernel.device.gate import exclusive
from .html_page import page, read_static
from .page_sources import Source, blob_of, settings_from


def widget_of(source: Source, *, height_px: int) -> Any:
    """Make the widget, which answers the page as long as the kernel runs.

    Raises:
        LidarSceneError: with what to install, where anywidget cannot be imported
    """
    anywidget = import_optional("anywidget", extra="notebook")
    traitlets = import_optional("traitlets", extra="notebook")
    traits = {
        "_esm": read_static("widget.js"),
        "page": traitlets.Unicode(page(source.title)).tag(sync=True),
        "height_px": traitlets.Int(height_px).tag(sync=True),
    }
    widget = type("LidarWidget", (anywidget.AnyWidget,), traits)()
    widget.on_msg(lambda _, question, __: widget.send(*answer(source, question)))
    return widget


@exclusive
def answer(source: Source, question: Any) -> tuple[dict[str, Any], Sequence[bytes]]:
    """Answer a question of the page: the message, and the blob that goes with it; an error is one line of the message.

    Args:
        question: number, name of a blob, and the settings of one that is rendered
    """
    message = {"number": question.get("number")}
    try:
        name = str(question.get("name"))
        if name == "render":
            return message, [source.render(settings_from(json.dumps(question.get("settings")).encode()))]
        job = blob_of(source, name)
        if job is None:
            raise InputError(f"{name}: must be stage, frame-NUMBER or render")
        return message, [job()]
    except LidarSceneError as error:
        return message | {"error": str(error)}, []
