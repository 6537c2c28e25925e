"""The buttons for a lecture: the page on the whole screen, and the code that lets other devices in."""

import segno
from nicegui import ui

_OUTLINE = "dense no-caps outline"


def window_buttons(invitation: str | None) -> None:
    """Make the buttons.

    Args:
        invitation: the link for other devices; None where they cannot reach the explorer.
    """
    if invitation is not None:
        with ui.dialog() as dialog, ui.card().classes("panel invitation"):
            ui.html("Scan the code to open this page on another device of this network", tag="h2", sanitize=False)
            code = segno.make_qr(invitation).svg_inline(scale=8, border=4, light="white", omitsize=True)
            ui.html(code, sanitize=False).props('role=img aria-label="QR code of the link"')
            ui.label(invitation).classes("invitation-link")
            ui.button("Close", on_click=dialog.close).props("dense no-caps flat")
        ui.button("Invite", icon="qr_code", on_click=dialog.open).props(_OUTLINE)
    screen = ui.fullscreen()
    ui.button("Full screen", icon="fullscreen", on_click=screen.toggle).props(_OUTLINE).classes("full-screen")
