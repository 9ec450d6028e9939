#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Folds `perf script` (from standard input) into a flame graph, an SVG on standard output: widths are shares of the
samples, callers below what they call (after Gregg 2016, "The flame graph", doi:10.1145/2909476).

usage: perf record -F 499 -g COMMAND && perf script -F comm,ip,sym | flame_graph.py TITLE > profile.svg
"""
import re
import sys
from xml.sax.saxutils import escape

WIDTH_PX, ROW_PX, CHAR_PX = 1200, 17, 6.6
LEAST_SHARE = 0.004  # narrower frames are left out
SHADES = ["#e8b04b", "#e3a03c", "#eabf69", "#dd9433", "#efc985"]


# Frames of how things are called, not of what is done.
PLUMBING = re.compile(r"(clone3?|start_thread|_start|__libc_start.*|main|std::.*|__invoke.*|_M_.*|call_once.*|__pthread_once.*)?")


def plain_name(symbol):
    """A C++ name without arguments, template arguments, lambdas and the namespaces that say nothing here."""
    symbol = re.sub(r"\+0x[0-9a-f]+$", "", symbol.strip()).replace("(anonymous namespace)", "")
    symbol = re.sub(r"operator[<>=!]+", "", symbol)
    previous = None
    while previous != symbol:  # innermost brackets first
        previous = symbol
        symbol = re.sub(r"<[^<>]*>|\([^()]*\)|\[[^\[\]]*\]", "", symbol)
    symbol = re.sub(r"\.(isra|part|constprop|cold).*|\{lambda[^}]*\}|\bconst\b|\boperator\b|'lambda\d*'", "", symbol)
    name = re.sub(r"(::)+", "::", symbol.replace("tind::", "")).strip(": ").split(" ")[-1].strip(":")
    return name


def stacks(lines):
    """Stacks of names, outermost first."""
    frames = []
    for line in lines:
        if not line.strip():
            if frames:
                yield frames[::-1]
            frames = []
        elif line[0].isspace() and "[unknown]" not in line:
            parts = line.split(None, 1)
            name = plain_name(parts[1]) if len(parts) > 1 else ""
            if not PLUMBING.fullmatch(name) and (not frames or frames[-1] != name):
                frames.append(name)
    if frames:
        yield frames[::-1]


class Frame:
    def __init__(self):
        self.samples, self.callees = 0, {}

    def add(self, stack):
        self.samples += 1
        if stack:
            self.callees.setdefault(stack[0], Frame()).add(stack[1:])

    def depth(self, least):
        return 1 + max([f.depth(least) for f in self.callees.values() if f.samples >= least], default=0)


def draw(frame, name, left, row, n_rows, total, least, out):
    width = WIDTH_PX * frame.samples / total
    top = (n_rows - row) * ROW_PX + 24
    percent = 100 * frame.samples / total
    shade = SHADES[sum(name.encode()) % len(SHADES)]
    label = name if len(name) * CHAR_PX <= width - 4 else name[:max(0, int((width - 4) / CHAR_PX) - 1)]
    out.append(f'<g><title>{escape(name)}: {percent:.1f} %</title><rect x="{left:.1f}" y="{top}" '
               f'width="{max(width - 0.5, 0.5):.1f}" height="{ROW_PX - 1}" fill="{shade}"/>')
    if len(label) > 2:
        out.append(f'<text x="{left + 3:.1f}" y="{top + 12}">{escape(label)}</text>')
    out.append("</g>")
    for callee_name, callee in sorted(frame.callees.items()):
        if callee.samples >= least:
            draw(callee, callee_name, left, row + 1, n_rows, total, least, out)
        left += WIDTH_PX * callee.samples / total


def main():
    title = sys.argv[1] if len(sys.argv) > 1 else "profile"
    root = Frame()
    for stack in stacks(sys.stdin):
        root.add(stack)
    if root.samples == 0:
        sys.exit("flame_graph: no samples; pipe `perf script -F comm,ip,sym` in")
    least = root.samples * LEAST_SHARE
    n_rows = root.depth(least) - 1
    height = (n_rows + 1) * ROW_PX + 32
    out = [f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH_PX}" height="{height}" '
           f'viewBox="0 0 {WIDTH_PX} {height}" '
           'font-family="monospace" font-size="11"><rect width="100%" height="100%" fill="#ffffff"/>',
           f'<text x="4" y="15" font-size="13">{escape(title)} ({root.samples} samples)</text>']
    draw(root, "all", 0.0, 0, n_rows, root.samples, least, out)
    out.append("</svg>")
    print("\n".join(out))


if __name__ == "__main__":
    main()
