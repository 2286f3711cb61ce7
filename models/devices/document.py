"""What a device is, as text and HTML: diagram, parameters, sources, what it was checked against."""

from __future__ import annotations

import html
from collections.abc import Iterable

from .language.device import NO_LIMIT, Device, Parameter

#: meaning of each element, for the documentation of every device
ELEMENTS = {
    "lag(u, T)": "T y' = K u - y within min .. max (non-windup); T = 0: y = K u",
    "leadlag(u, T1, T2)": "y = K u (1 + s T1)/(1 + s T2); T2 = 0: y = K u",
    "washout(u, T)": "y = K u s T/(1 + s T); T = 0: y = K u",
    "rate(u, K, T)": "y = u s K/(1 + s T); K = 0: absent",
    "integrator(u)": "T y' = K u within min .. max (non-windup)",
    "pi(u, KP, KI)": "y = KP u + KI u/s + add within min .. max, with conditional integration",
    "filter2(u, A1, A2, B1, B2)": "y = u (1 + B1 s + B2 s^2)/(1 + A1 s + A2 s^2)",
    "vx(E, E1, S1, E2, S2)": "E SE(E) = B (E - A)^2 above A, through both points (scaled quadratic of PSS/E)",
    "ramp(u, T1, T2, M, N)": "y = u ((1 + s T1)/(1 + s T2)^M)^N as up to eight lead-lags, M N <= 8",
    "vx_inverse(F, KE, E1, S1, E2, S2)": "the v for which KE v + vx(v) = F",
    "fex(n)": "regulation of a rectifier",
    "min(a, b, ...)": "least of two to four values",
    "max(a, b, ...)": "largest of two to four values",
    "lv(a, b, ...)": "low-value gate, as min",
    "hv(a, b, ...)": "high-value gate, as max",
    "clamp(u, low, high)": "u within low .. high",
    "deadband(u, w)": "0 within -w .. w; u reduced by w in magnitude beyond",
    "pick(condition, a, b)": "a if a comparison such as KF > 0 holds, else b",
    "table(u, x1, y1, x2, y2, ...)": "linear between the points, constant beyond the ends",
    "abs(u)": "absolute value",
    "sqrt(u)": "square root",
    "exp(u)": "exponential",
    "log(u)": "natural logarithm",
    "sin(u)": "sine, u in rad",
    "cos(u)": "cosine, u in rad",
}
#: options after the arguments of an element
OPTIONS = {
    "K=gain": "of lag, leadlag, washout, integrator; default 1",
    "T=time": "of an integrator, s; default 1",
    "min=a, max=b": "of lag, integrator, pi (non-windup) and leadlag (of its output); they may vary",
    "rate_min=a, rate_max=b": "of a lag: bounds of its rate, 1/s",
    "add=u": "of a pi: added inside its limits, such as a derivative part",
    "feedback=g": "of a pi: g times its output is subtracted from its input",
    "rest=value": "of a lag, integrator or pi: equilibrium value if no other condition sets it",
    "freeze=flag": "of a lag, integrator or pi: its state is held while this is 1",
}


def diagram_text(device: Device) -> str:
    """Return the diagram with parameters put in, one line a signal."""
    rows = [(f"{line.name} = {line.node}", line.comment) for line in device.lines]
    width = min(max(len(row) for row, _ in rows), 72)
    return "\n".join(f"{row:<{width}}  # {comment}" if comment else row for row, comment in rows)


def range_text(p: Parameter) -> str:
    """Return the range of a parameter in words."""
    low = "" if p.low <= -NO_LIMIT else f"> {p.low:g}" if p.open else f">= {p.low:g}"
    high = "" if p.high >= NO_LIMIT else f"<= {p.high:g}"
    return ", ".join(part for part in (low, high) if part)


def device_html(device: Device) -> str:
    """Return one device as HTML; everything from the file is escaped."""
    rows = "".join(
        f"<tr><td><code>{html.escape(p.name)}</code></td><td>{html.escape(p.unit)}</td>"
        f"<td>{html.escape(range_text(p))}</td><td>{html.escape(p.text)}</td></tr>"
        for p in device.parameters
    )
    checked = (
        f"Checked against: {device.oracle}." if device.oracle else "Not checked against another program."
    )
    notes = f" {device.notes}." if device.notes else ""
    return (
        f"<h4>{html.escape(device.name)}: {html.escape(device.title)}</h4>"
        f"<pre>{html.escape(diagram_text(device))}</pre>"
        f"<table><tr><th>parameter</th><th>unit</th><th>range</th><th>what</th></tr>{rows}</table>"
        f"<p>{html.escape('; '.join(device.sources))}. {html.escape(checked)}{html.escape(notes)}</p>"
    )


def devices_html(devices: Iterable[Device]) -> str:
    """Return several devices as HTML, after what the elements in them mean."""
    devices = list(devices)
    used = {line.node.op for device in devices for line in device.lines}
    used |= {part.op for device in devices for line in device.lines for part in line.node.args}
    words = "".join(
        f"<tr><td><code>{html.escape(call)}</code></td><td>{html.escape(text)}</td></tr>"
        for call, text in ELEMENTS.items()
        if call.partition("(")[0] in used
    )
    return f"<table>{words}</table>" + "".join(device_html(device) for device in devices)
