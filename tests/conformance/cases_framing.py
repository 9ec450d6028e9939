# SPDX-License-Identifier: GPL-3.0-or-later
"""RFC 9112: request line, fields, framing, connections."""
from case import CLOSE, OTHER, TILE, Case, body_is_whole, date_is_now, every, field_is, has_members, in_order, request

REFUSED = [{400}]
SMUGGLED = f"GET {OTHER} HTTP/1.1\r\nHost: h\r\n\r\n".encode()


def line(text, fields="Host: h\r\n"):
    return text + f"\r\n{fields}\r\n".encode("latin-1")


def body(fields, data=b"", **more):
    return request(fields, body=data, **more)


REQUEST_LINE = [
    Case("leading empty line", "RFC 9112 2.2", b"\r\n" + request(), [{200}], False, body_is_whole),
    Case("two leading empty lines", "RFC 9112 2.2", b"\r\n\r\n" + request(), [{200}], False, body_is_whole, nginx=True),
    Case("bare LF ends lines", "RFC 9112 2.2", request().replace(b"\r\n", b"\n"), [{200, 400}], None, tind=REFUSED),
    Case("bare CR in a field", "RFC 9112 2.2", request("X: a\rb\r\n"), [{400, 200}], None, tind=REFUSED),
    Case("bare CR between lines", "RFC 9112 2.2", b"GET " + TILE.encode() + b" HTTP/1.1\rHost: h\r\n\r\n", REFUSED, True),
    Case("blank before the first field", "RFC 9112 2.2", line(f"GET {TILE} HTTP/1.1".encode(), " Host: h\r\n"), REFUSED, True),
    Case("HTTP/1.0 without Host", "RFC 9112 2.3", request(host="", version="HTTP/1.0"), [{200}], True, body_is_whole),
    Case("a higher minor version is 1.1", "RFC 9110 2.5", request(version="HTTP/1.2"), [{200}], None, body_is_whole),
    Case("major version 2", "RFC 9110 15.6.6", request(version="HTTP/2.0"), [{505}], None, tind=[{505}]),
    Case("major version 3", "RFC 9110 15.6.6", request(version="HTTP/3.0"), [{505}]),
    Case("version in lower case", "RFC 9112 2.3", request(version="http/1.1"), REFUSED, True),
    Case("version with two digits", "RFC 9112 2.3", request(version="HTTP/1.10"), [{400, 505}], True),
    Case("version without a dot", "RFC 9112 2.3", request(version="HTTP/11"), [{400, 505}], True),
    Case("no version", "RFC 9112 3", line(f"GET {TILE}".encode(), ""), [{400, 505}], True),
    Case("text after the version", "RFC 9112 3", request(version="HTTP/1.1 x"), REFUSED, True),
    Case("no target", "RFC 9112 3", line(b"GET  HTTP/1.1"), REFUSED, True),
    Case("only a method", "RFC 9112 3", line(b"GET"), REFUSED, True),
    Case("blank in the target", "RFC 9112 3.2", request(target="/a b"), REFUSED, True),
    Case("no token as method", "RFC 9112 3.1", request(method="GE(T"), [{400, 501}], None, tind=REFUSED),
    Case("method in lower case", "RFC 9110 9.1", request(method="get"), [{400, 405, 501}], None),
    Case("target of 20,000 bytes", "RFC 9110 15.5.15", request(target="/" + "a" * 20000), [{414}], True),
    Case("request line of 8,000 bytes is taken", "RFC 9112 3", request(target="/" + "a" * (8000 - len("GET / HTTP/1.1"))), [{404}], False),
    Case("8-bit target", "RFC 3986 2", request(target="/\xe9"), REFUSED, True),
    Case("control byte in the target", "RFC 3986 2", request(target="/\x01"), REFUSED, True),
    Case("NUL in the target", "RFC 3986 2", request(target="/a\0b"), REFUSED, True),
    Case("fragment in the target", "RFC 9112 3.2.1", request(target=TILE + "#f"), REFUSED),
    Case("broken percent-encoding", "RFC 3986 2.1", request(target="/%zz"), REFUSED),
    Case("dots in the target stay inside", "RFC 3986 5.2.4", request(target="/../../etc/passwd"), [{400, 404}]),
    Case("encoded dots stay inside", "RFC 3986 2.4", request(target="/%2e%2e/%2e%2e/etc/passwd"), [{400, 404}]),
]

TARGETS = [
    Case("absolute-form", "RFC 9112 3.2.2", request(target="http://h" + TILE), [{200}], False, body_is_whole),
    Case("absolute-form wins over Host", "RFC 9112 3.2.2", request(target="http://other:99" + TILE), [{200}], False, body_is_whole),
    Case("absolute-form without a path", "RFC 9112 3.2.2", request(target="http://h"), [{200}], False),
    Case("absolute-form needs Host, too", "RFC 9112 3.2", request(target="http://h" + TILE, host=""), REFUSED, True),
    Case("authority-form with GET", "RFC 9112 3.2.3", request(target="h:80"), REFUSED),
    Case("asterisk-form with GET", "RFC 9112 3.2.4", request(target="*"), REFUSED),
    Case("OPTIONS *", "RFC 9110 9.3.7", request(target="*", method="OPTIONS"), [{200, 204}], False),
    Case("CONNECT is no tunnel", "RFC 9110 9.3.6", request(target="h:80", method="CONNECT"), [{400, 405, 501}]),
    Case("a relative target", "RFC 9112 3.2", request(target=TILE[1:]), REFUSED),
]

FIELDS = [
    Case("no Host", "RFC 9112 3.2", request(host=""), REFUSED, True),
    Case("two Hosts", "RFC 9112 3.2", request("Host: h\r\n"), REFUSED, True),
    Case("two different Hosts", "RFC 9112 3.2", request("Host: g\r\n"), REFUSED, True),
    Case("blank in Host", "RFC 9112 3.2", request(host="Host: a b\r\n"), REFUSED, True),
    Case("path in Host", "RFC 9112 3.2", request(host="Host: h/p\r\n"), REFUSED, True),
    Case("user in Host", "RFC 9110 7.2", request(host="Host: u@h\r\n"), REFUSED, True),
    Case("list in Host", "RFC 9110 7.2", request(host="Host: h, g\r\n"), REFUSED, True),
    Case("empty Host", "RFC 9112 3.2", request(host="Host:\r\n"), [{200}], False),
    Case("Host with a port", "RFC 9110 7.2", request(host="Host: h:8080\r\n"), [{200}], False),
    Case("Host with an IPv6 address", "RFC 9110 7.2", request(host="Host: [::1]:8080\r\n"), [{200}], False),
    Case("Host with a bad port", "RFC 9110 7.2", request(host="Host: h:8x\r\n"), REFUSED, True),
    Case("blank before the colon", "RFC 9112 5.1", request("X : a\r\n"), REFUSED, True),
    Case("tab before the colon", "RFC 9112 5.1", request("X\t: a\r\n"), REFUSED, True),
    Case("obs-fold", "RFC 9112 5.2", request("X: a\r\n b\r\n"), [{400, 200}], None, tind=REFUSED),
    Case("obs-fold in Host", "RFC 9112 5.2", request(host="Host: h\r\n b\r\n"), REFUSED, True),
    Case("no field name", "RFC 9112 5", request(": a\r\n"), REFUSED, True),
    Case("no token as field name", "RFC 9110 5.1", request("X(y: a\r\n"), REFUSED, True),
    Case("8-bit field name", "RFC 9110 5.1", request("X\xe9: a\r\n"), REFUSED, True),
    Case("line without a colon", "RFC 9112 5", request("nonsense\r\n"), REFUSED, True),
    Case("NUL in a field", "RFC 9110 5.5", request("X: a\0b\r\n"), REFUSED, True),
    Case("8-bit bytes in a field are data", "RFC 9110 5.5", request("X: \xe9\xff\r\n"), [{200}], False),
    Case("empty field value", "RFC 9110 5.5", request("X:\r\n"), [{200}], False),
    Case("field names in any case", "RFC 9110 5.1", lambda w: request(f"iF-nOnE-MATCH: {w.etag}\r\n", host="hOST: h\r\n"), [{304}], False),
    Case("blanks and tabs around a value", "RFC 9112 5.1", lambda w: request(f"If-None-Match:\t {w.etag} \t\r\n"), [{304}], False),
    Case("100 unknown fields", "RFC 9110 5.1", request("".join(f"X-{k}: v\r\n" for k in range(100))), [{200}], False),
    Case("8,000 bytes of fields are taken", "RFC 9110 5.4", request("X: " + "a" * 8000 + "\r\n"), [{200}], False),
    Case("fields of 100 KB", "RFC 9110 5.4", request("X: " + "a" * 100000 + "\r\n"), [{400, 431}], True, tind=[{431}]),
    Case("10,000 fields", "RFC 9110 5.4", request("A: b\r\n" * 10000), [{400, 431}], True, tind=[{431}]),
]

# GET has no use for a body; what counts is where the next request begins.
FRAMING = [
    Case("a body is read past", "RFC 9112 6.3", body("Content-Length: 5\r\n", b"hello") + SMUGGLED, [{200}, {200}], False, in_order),
    Case("a body that looks like a request", "RFC 9112 6.3", body(f"Content-Length: {len(SMUGGLED)}\r\n", SMUGGLED), [{200}], False),
    Case("chunked body", "RFC 9112 7.1", body("Transfer-Encoding: chunked\r\n", b"5\r\nhello\r\n0\r\n\r\n"), [{200}], None, body_is_whole),
    Case("Transfer-Encoding in capitals", "RFC 9110 5.1", body("TRANSFER-ENCODING: CHUNKED\r\n", b"0\r\n\r\n"), [{200}], None, body_is_whole),
    Case("chunked body with trailer fields", "RFC 9112 7.1.2", body("Transfer-Encoding: chunked\r\n", b"1\r\na\r\n0\r\nX: y\r\nHost: g\r\n\r\n"), [{200}], None, body_is_whole),
    Case("CL and TE", "RFC 9112 6.1", body("Content-Length: 5\r\nTransfer-Encoding: chunked\r\n", b"0\r\n\r\n" + SMUGGLED), [{400, 200}], True, tind=REFUSED),
    Case("TE and CL", "RFC 9112 6.1", body(f"Transfer-Encoding: chunked\r\nContent-Length: {5 + len(SMUGGLED)}\r\n", b"0\r\n\r\n" + SMUGGLED), [{400, 200}], True, tind=REFUSED),
    Case("TE: xchunked", "RFC 9112 6.1", body("Transfer-Encoding: xchunked\r\n", SMUGGLED), [{400, 501}], True),
    Case("TE: gzip", "RFC 9112 6.3", body("Transfer-Encoding: gzip\r\n", SMUGGLED), [{400, 501}], True),
    Case("TE: chunked, gzip", "RFC 9112 6.3", body("Transfer-Encoding: chunked, gzip\r\n", SMUGGLED), [{400, 501}], True),
    Case("TE: chunked, chunked", "RFC 9112 6.1", body("Transfer-Encoding: chunked, chunked\r\n", b"0\r\n\r\n" + SMUGGLED), [{400, 501}], True),
    Case("TE: chunked twice", "RFC 9112 6.1", body("Transfer-Encoding: chunked\r\nTransfer-Encoding: chunked\r\n", b"0\r\n\r\n" + SMUGGLED), [{400, 501}], True),
    Case("TE: chunked and identity", "RFC 9112 6.1", body("Transfer-Encoding: chunked\r\nTransfer-Encoding: identity\r\n", b"0\r\n\r\n" + SMUGGLED), [{400, 501}], True),
    Case("TE: a vertical tab before chunked", "RFC 9112 6.1", body("Transfer-Encoding: \x0bchunked\r\n", b"0\r\n\r\n" + SMUGGLED), [{400, 501}], True),
    Case("TE: quoted", "RFC 9112 6.1", body('Transfer-Encoding: "chunked"\r\n', SMUGGLED), [{400, 501}], True),
    Case("TE with a blank before the colon", "RFC 9112 5.1", body("Transfer-Encoding : chunked\r\n", b"0\r\n\r\n" + SMUGGLED), REFUSED, True),
    Case("TE: empty", "RFC 9112 6.1", body("Transfer-Encoding:\r\n", SMUGGLED), [{400, 501}], True),
    Case("TE in HTTP/1.0", "RFC 9112 6.1", body("Connection: keep-alive\r\nTransfer-Encoding: chunked\r\n", b"0\r\n\r\n" + SMUGGLED, version="HTTP/1.0"), [{400, 501, 200}], True, tind=REFUSED),
    Case("two different CLs", "RFC 9112 6.3", body("Content-Length: 5\r\nContent-Length: 6\r\n", b"hello!" + SMUGGLED), REFUSED, True),
    Case("CL: 5, 6", "RFC 9112 6.3", body("Content-Length: 5, 6\r\n", b"hello!" + SMUGGLED), REFUSED, True),
    Case("CL: 5, 5", "RFC 9112 6.3", body("Content-Length: 5, 5\r\n", b"hello"), [{400, 200}], None, tind=REFUSED),
    Case("CL: +5", "RFC 9112 6.3", body("Content-Length: +5\r\n", b"hello" + SMUGGLED), REFUSED, True),
    Case("CL: -1", "RFC 9112 6.3", body("Content-Length: -1\r\n", SMUGGLED), REFUSED, True),
    Case("CL: 0x5", "RFC 9112 6.3", body("Content-Length: 0x5\r\n", b"hello" + SMUGGLED), REFUSED, True),
    Case("CL: 5 5", "RFC 9112 6.3", body("Content-Length: 5 5\r\n", b"hello" + SMUGGLED), REFUSED, True),
    Case("CL: empty", "RFC 9112 6.3", body("Content-Length:\r\n", SMUGGLED), REFUSED, True),
    Case("CL: 2^64", "RFC 9112 6.3", body("Content-Length: 18446744073709551616\r\n", SMUGGLED), [{400, 413}], True),
    Case("CL: 2^64 + 5", "RFC 9112 6.3", body("Content-Length: 18446744073709551621\r\n", b"hello" + SMUGGLED), [{400, 413}], True),
    Case("chunk size above 2^64", "RFC 9112 7.1", body("Transfer-Encoding: chunked\r\n", b"1ffffffffffffffff\r\na\r\n0\r\n\r\n" + SMUGGLED), [{200, 400, 413}], True),
    Case("chunk size 2^64 + 5", "RFC 9112 7.1", body("Transfer-Encoding: chunked\r\n", b"10000000000000005\r\nhello\r\n0\r\n\r\n" + SMUGGLED), [{200, 400, 413}], True),
    Case("chunk size -1", "RFC 9112 7.1", body("Transfer-Encoding: chunked\r\n", b"-1\r\n\r\n" + SMUGGLED), [{200, 400}], True),
    Case("chunk size 0x0", "RFC 9112 7.1", body("Transfer-Encoding: chunked\r\n", b"0x0\r\n\r\n" + SMUGGLED), [{200, 400}], True),
    Case("chunk extension of 100 KB", "RFC 9112 7.1.1", body("Transfer-Encoding: chunked\r\n", b"1;" + b"x" * 100000 + b"\r\na\r\n0\r\n\r\n"), [{200, 400, 413}], None, body_is_whole),
    Case("chunk longer than its size", "RFC 9112 7.1", body("Transfer-Encoding: chunked\r\n", b"1\r\nhello\r\n0\r\n\r\n" + SMUGGLED), [{200, 400}], True),
    Case("Expect: 100-continue gets an answer", "RFC 9110 10.1.1", body("Expect: 100-continue\r\nContent-Length: 5\r\n"), [{200, 417}]),
    Case("no 100 in HTTP/1.0", "RFC 9110 10.1.1", request("Expect: 100-continue\r\nContent-Length: 5\r\n", version="HTTP/1.0", body=b"hello"), [{200}], True,
         lambda answers, _: "there is a 100" if answers[0].interim else None),
    Case("unknown expectation", "RFC 9110 10.1.1", request("Expect: tea\r\n"), [{200, 417}]),
]

CONNECTIONS = [
    Case("connections stay open", "RFC 9112 9.3", request() + request("", OTHER), [{200}, {200}], False, in_order),
    Case("Connection: close", "RFC 9112 9.6", request(CLOSE), [{200}], True, every(has_members("Connection", "close"), date_is_now)),
    Case("Connection: Foo, CLOSE", "RFC 9110 7.6.1", request("Connection: Foo, CLOSE\r\n"), [{200}], True),
    Case("Connection: close in a second line", "RFC 9110 5.3", request("Connection: keep-alive\r\nConnection: close\r\n"), [{200}], True),
    Case("nothing is answered after close", "RFC 9112 9.6", request(CLOSE) + SMUGGLED, [{200}], True),
    Case("HTTP/1.0 closes", "RFC 9112 9.3", request(version="HTTP/1.0"), [{200}], True),
    Case("HTTP/1.0 with keep-alive", "RFC 9112 9.3", request("Connection: keep-alive\r\n", version="HTTP/1.0"), [{200}], False, has_members("Connection", "keep-alive")),
    Case("HTTP/1.0 answers are not chunked", "RFC 9112 6.1", request(version="HTTP/1.0"), [{200}], True, field_is("Transfer-Encoding", None)),
    Case("pipelining keeps the order", "RFC 9112 9.3.2", request() + request("", OTHER) + request(CLOSE), [{200}, {200}, {200}], True, in_order),
    Case("pipelining, the second is broken", "RFC 9112 9.3.2", request() + b"nonsense\r\n\r\n" + SMUGGLED, [{200}, {400}], True),
    Case("HEAD and 304 in a pipeline", "RFC 9112 6.3", lambda w: request(method="HEAD") + request(f"If-None-Match: {w.etag}\r\n") + request(CLOSE), [{200}, {304}, {200}], True,
         methods=("HEAD", "GET", "GET"), check=lambda answers, w: body_is_whole(answers[2:], w)),
    Case("half-close after the request", "RFC 9112 9.6", request(), [{200}], True, body_is_whole, half_close=True),
    Case("half-close within the request", "RFC 9112 8", request()[:30], [], True, tind=[], half_close=True),
    Case("half-close after a pipeline", "RFC 9112 9.6", request() + SMUGGLED, [{200}, {200}], True, in_order, half_close=True),
    Case("byte by byte", "RFC 9112 2.2", request() + SMUGGLED, [{200}, {200}], False, in_order, byte_by_byte=True),
    Case("an upgrade that nobody wants", "RFC 9110 7.8", request("Connection: Upgrade, HTTP2-Settings\r\nUpgrade: h2c\r\nHTTP2-Settings: AAMAAABk\r\n"), [{200}], False, body_is_whole),
    Case("the head is late", "RFC 9110 15.5.9", request()[:30], [{408}], True),
]

CASES = REQUEST_LINE + TARGETS + FIELDS + FRAMING + CONNECTIONS
