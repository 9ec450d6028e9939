# SPDX-License-Identifier: GPL-3.0-or-later
"""Raw HTTP/1.1 over a socket: sends the bytes it is given and cuts answers apart strictly."""
import re
import socket
import time

PATIENCE_S = 10


class WireError(Exception):
    """What came is no answer, or none came."""


class Answer:
    """One answer. `fields`: list of (lower-case name, value) in order."""

    def __init__(self, version, status, fields):
        self.version, self.status, self.fields, self.body = version, status, fields, b""

    def all(self, name):
        return [value for key, value in self.fields if key == name.lower()]

    def field(self, name):
        """The only value of a field; None when absent."""
        values = self.all(name)
        if len(values) > 1:
            raise WireError(f"field {name} occurs {len(values)} times")
        return values[0] if values else None


STATUS_LINE = re.compile(rb"HTTP/(1\.[01]) ([1-5][0-9][0-9]) [\t\x20-\x7e\x80-\xff]*\Z")
FIELD_LINE = re.compile(rb"([!#$%&'*+.^_`|~0-9A-Za-z-]+):[ \t]*([\x21-\x7e\x80-\xff](?:[\t\x20-\x7e\x80-\xff]*[\x21-\x7e\x80-\xff])?|)[ \t]*\Z")


def parse_head(block):
    """`block` without its empty line. The grammar of RFC 9112, 4 and 5."""
    lines = block.split(b"\r\n")
    start = STATUS_LINE.match(lines[0])
    if not start:
        raise WireError(f"no status line: {lines[0][:80]!r}")
    fields = []
    for line in lines[1:]:
        found = FIELD_LINE.match(line)
        if not found:
            raise WireError(f"no field line: {line[:80]!r}")
        fields.append((found[1].decode().lower(), found[2].decode("latin-1")))
    return Answer(start[1].decode(), int(start[2]), fields)


class Connection:
    def __init__(self, port, host="127.0.0.1", receive_buffer_bytes=None, patience_s=PATIENCE_S):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        if receive_buffer_bytes:
            self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer_bytes)
        self.socket.settimeout(patience_s)
        self.socket.connect((host, port))
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.pending = b""

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.socket.close()

    def send(self, data, byte_by_byte=False):
        """A peer that has closed already is no error here: what it answered is still read."""
        try:
            if not byte_by_byte:
                self.socket.sendall(data)
                return
            for k in range(len(data)):
                self.socket.sendall(data[k:k + 1])
                time.sleep(0.0005)
        except OSError:
            pass

    def end_sending(self):
        try:
            self.socket.shutdown(socket.SHUT_WR)
        except OSError:
            pass

    def fill(self):
        try:
            chunk = self.socket.recv(65536)
        except socket.timeout as error:
            raise WireError("nothing came in time") from error
        except OSError as error:
            raise WireError(f"the connection broke: {error}") from error
        self.pending += chunk
        return len(chunk) > 0

    def receive(self, method="GET"):
        """The next final answer; answers 1xx before it are in its list `interim`."""
        interim = []
        while True:
            while b"\r\n\r\n" not in self.pending:
                if not self.fill():
                    raise WireError("closed without an answer" if not self.pending else "closed within an answer's head")
            head, self.pending = self.pending.split(b"\r\n\r\n", 1)
            answer = parse_head(head)
            if answer.status >= 200:
                break
            interim.append(answer)
        answer.interim = interim
        if method == "HEAD" or answer.status in (204, 304):
            return answer
        if answer.field("Transfer-Encoding"):
            self.receive_chunked(answer)
            return answer
        length = answer.field("Content-Length")
        if length is None:
            while self.fill():
                pass
            answer.body, self.pending = self.pending, b""
            return answer
        if not re.fullmatch(r"[0-9]{1,15}", length):
            raise WireError(f"Content-Length {length!r}")
        while len(self.pending) < int(length):
            if not self.fill():
                raise WireError(f"closed after {len(self.pending)} of {length} bytes")
        answer.body, self.pending = self.pending[:int(length)], self.pending[int(length):]
        return answer

    def receive_chunked(self, answer):
        while True:
            while b"\r\n" not in self.pending:
                if not self.fill():
                    raise WireError("closed within a chunked body")
            line, self.pending = self.pending.split(b"\r\n", 1)
            size = int(line.split(b";")[0], 16)
            while len(self.pending) < size + 2:
                if not self.fill():
                    raise WireError("closed within a chunk")
            answer.body += self.pending[:size]
            self.pending = self.pending[size + 2:]
            if size == 0:
                return

    def closes(self):
        """True iff the peer closes within the patience and sends nothing more before."""
        if self.pending:
            return False
        try:
            return not self.fill()
        except WireError as error:
            return "broke" in str(error)


def ask(port, target, fields="", method="GET", **options):
    """One request on a connection of its own."""
    with Connection(port, **options) as connection:
        connection.send(f"{method} {target} HTTP/1.1\r\nHost: h\r\nConnection: close\r\n{fields}\r\n".encode("latin-1"))
        return connection.receive(method)
