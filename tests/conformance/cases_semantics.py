# SPDX-License-Identifier: GPL-3.0-or-later
"""RFC 9110 (methods, conditions, ranges, negotiation), 9111 (what caches need) and 9457 (error bodies)."""
import re

from case import (CLOSE, IMF, OTHER, TILE, Case, body_is_whole, date_is_now, decoded, every, field_is, field_matches, get, gmtime,
                  has_members, is_problem, no_body, request)

ALLOW = has_members("Allow", "GET", "HEAD")
MISSING = "/world/1/3/9.terrain"  # no such resource on either server


def head_is_get(answers, _):
    """HEAD has GET's fields (RFC 9110, 9.3.2), but for the time and the connection."""
    head, whole = ([pair for pair in answer.fields if pair[0] not in ("date", "connection")] for answer in answers[:2])
    return None if head == whole else f"the fields differ: {sorted(set(head) ^ set(whole))}"


def head_and_get(fields="", target=TILE):
    return lambda _: request(fields, target, "HEAD") + request(fields, target)


METHODS = [
    Case("GET", "RFC 9110 9.3.1", request(), [{200}], False, body_is_whole),
    Case("HEAD has no body", "RFC 9110 9.3.2", request(method="HEAD"), [{200}], False, field_matches("Content-Length", "[1-9][0-9]*"), methods=("HEAD",)),
    Case("HEAD has GET's fields", "RFC 9110 9.3.2", head_and_get(), [{200}, {200}], False, head_is_get, methods=("HEAD", "GET")),
    Case("HEAD has GET's fields, coded", "RFC 9110 9.3.2", head_and_get("Accept-Encoding: gzip\r\n"), [{200}, {200}], False, head_is_get, methods=("HEAD", "GET")),
    Case("HEAD has GET's fields, not found", "RFC 9110 9.3.2", head_and_get("", MISSING), [{404}, {404}], False, head_is_get, methods=("HEAD", "GET")),
    Case("OPTIONS names the methods", "RFC 9110 9.3.7", request(method="OPTIONS"), [{200, 204}], False, ALLOW),
    Case("POST", "RFC 9110 15.5.6", request("Content-Length: 0\r\n", method="POST"), [{405}], None, ALLOW),
    Case("PUT", "RFC 9110 15.5.6", request("Content-Length: 0\r\n", method="PUT"), [{405}], None, ALLOW),
    Case("DELETE", "RFC 9110 15.5.6", request(method="DELETE"), [{405}], None, ALLOW),
    Case("PATCH", "RFC 9110 15.5.6", request("Content-Length: 0\r\n", method="PATCH"), [{405}], None, ALLOW),
    Case("TRACE", "RFC 9110 9.3.8", request(method="TRACE"), [{405}], None, ALLOW),
    Case("a method that nobody knows", "RFC 9110 9.1", request(method="BREW"), [{501}]),
    Case("POST's body is read past", "RFC 9112 6.3", request("Content-Length: 5\r\n", method="POST", body=b"hello") + request(), [{405}, {200}], None),
    Case("a missing resource", "RFC 9110 15.5.5", request(target=MISSING), [{404}], False, date_is_now),
    Case("Date is now", "RFC 9110 6.6.1", request(), [{200}], False, date_is_now),
    Case("Date in failures", "RFC 9110 6.6.1", request(host="") , [{400}], True, date_is_now),
    Case("Content-Type", "RFC 9110 8.3", request(), [{200}], False, field_is("Content-Type", "application/vnd.quantized-mesh")),
    Case("no Content-Length in 204", "RFC 9110 8.6", request(method="OPTIONS"), [{204}], False, field_is("Content-Length", None), nginx=False),
    Case("a directory is redirected", "RFC 9110 15.4.9", request(target="/world"), [{301, 308}], None, field_matches("Location", r"(http://h(:[0-9]+)?/)?/?world/")),
]


def etag_is_strong(answers, _):
    return field_matches("ETag", r'"[\x21\x23-\x7e\x80-\xff]*"')(answers, None)


def condition(name, rfc, fields, answers, check=None, **more):
    return get(name, rfc, lambda w: fields(w) if callable(fields) else fields, answers, check, **more)


def same_as_200(answers, world):
    """What RFC 9110, 15.4.5, wants of a 304."""
    wrong = [name for name in ("ETag", "Cache-Control", "Content-Location", "Expires", "Vary")
             if answers[0].field(name) != world.plain.field(name)]
    return f"differs from the 200: {', '.join(wrong)}" if wrong else None


CONDITIONS = [
    condition("a strong ETag", "RFC 9110 8.8.3", "", {200}, etag_is_strong),
    condition("Last-Modified", "RFC 9110 8.8.2", "", {200}, field_matches("Last-Modified", IMF)),
    condition("If-None-Match", "RFC 9110 13.1.2", lambda w: f"If-None-Match: {w.etag}\r\n", {304}, every(no_body, date_is_now)),
    condition("304 has the 200's fields", "RFC 9110 15.4.5", lambda w: f"If-None-Match: {w.etag}\r\n", {304}, same_as_200),
    condition("If-None-Match is compared weakly", "RFC 9110 13.1.2", lambda w: f"If-None-Match: W/{w.etag}\r\n", {304}),
    condition("If-None-Match, in a list", "RFC 9110 13.1.2", lambda w: f'If-None-Match: "a", {w.etag} , "b"\r\n', {304}),
    condition("If-None-Match, behind a tag with a comma", "RFC 9110 8.8.3", lambda w: f'If-None-Match: "a,b",{w.etag}\r\n', {304}),
    condition("If-None-Match, an empty member", "RFC 9110 5.6.1", lambda w: f'If-None-Match: ,, {w.etag}\r\n', {304}),
    condition("If-None-Match in two lines", "RFC 9110 5.3", lambda w: f'If-None-Match: "a"\r\nIf-None-Match: {w.etag}\r\n', {304}),
    condition("If-None-Match: *", "RFC 9110 13.1.2", "If-None-Match: *\r\n", {304}),
    condition("If-None-Match, another tag", "RFC 9110 13.1.2", 'If-None-Match: "a", W/"b"\r\n', {200}, body_is_whole),
    condition("If-None-Match, part of the tag", "RFC 9110 8.8.3.2", lambda w: f"If-None-Match: {w.etag[:-2]}\"\r\n", {200}),
    condition("If-None-Match without quotes", "RFC 9110 8.8.3", lambda w: f"If-None-Match: {w.etag.strip(chr(34))}\r\n", {200, 400}),
    condition("If-None-Match with HEAD", "RFC 9110 13.1.2", lambda w: f"If-None-Match: {w.etag}\r\n", {304}, method="HEAD"),
    condition("If-None-Match on a missing resource", "RFC 9110 13.2.1", "If-None-Match: *\r\n", {404}, target=MISSING),
    condition("If-None-Match wins over If-Modified-Since", "RFC 9110 13.1.3", lambda w: f'If-None-Match: "a"\r\nIf-Modified-Since: {gmtime(w.modified)}\r\n', {200}),
    condition("If-None-Match wins, the other way", "RFC 9110 13.1.3", lambda w: f"If-None-Match: {w.etag}\r\nIf-Modified-Since: {gmtime(0)}\r\n", {304}),
    condition("If-Modified-Since, the same time", "RFC 9110 13.1.3", lambda w: f"If-Modified-Since: {gmtime(w.modified)}\r\n", {304}, no_body),
    condition("If-Modified-Since with HEAD", "RFC 9110 13.1.3", lambda w: f"If-Modified-Since: {gmtime(w.modified)}\r\n", {304}, method="HEAD"),
    condition("If-Modified-Since, earlier", "RFC 9110 13.1.3", lambda w: f"If-Modified-Since: {gmtime(w.modified - 1)}\r\n", {200}),
    condition("If-Modified-Since, RFC 850 date", "RFC 9110 5.6.7", lambda w: f"If-Modified-Since: {gmtime(w.modified, 'rfc850')}\r\n", {304}),
    condition("If-Modified-Since, asctime date", "RFC 9110 5.6.7", lambda w: f"If-Modified-Since: {gmtime(w.modified, 'asctime')}\r\n", {304}),
    condition("If-Modified-Since, RFC 850 date, earlier", "RFC 9110 5.6.7", lambda w: f"If-Modified-Since: {gmtime(w.modified - 1, 'rfc850')}\r\n", {200}),
    condition("If-Modified-Since, asctime date, earlier", "RFC 9110 5.6.7", lambda w: f"If-Modified-Since: {gmtime(w.modified - 1, 'asctime')}\r\n", {200}),
    condition("If-Modified-Since, no date", "RFC 9110 13.1.3", "If-Modified-Since: tomorrow\r\n", {200}),
    condition("If-Modified-Since, no such day", "RFC 9110 13.1.3", "If-Modified-Since: Mon, 32 Feb 2040 00:00:00 GMT\r\n", {200}),
    condition("If-Modified-Since in two lines", "RFC 9110 13.1.3", lambda w: f"If-Modified-Since: {gmtime(w.modified)}\r\nIf-Modified-Since: {gmtime(w.modified)}\r\n", {200, 400}),
    condition("If-Match, the tag", "RFC 9110 13.1.1", lambda w: f"If-Match: {w.etag}\r\n", {200}, body_is_whole),
    condition("If-Match: *", "RFC 9110 13.1.1", "If-Match: *\r\n", {200}),
    condition("If-Match, in a list", "RFC 9110 13.1.1", lambda w: f'If-Match: "a", {w.etag}\r\n', {200}),
    condition("If-Match, another tag", "RFC 9110 13.1.1", 'If-Match: "a"\r\n', {412}),
    condition("If-Match is compared strongly", "RFC 9110 13.1.1", lambda w: f"If-Match: W/{w.etag}\r\n", {412}),
    condition("If-Match comes before If-None-Match", "RFC 9110 13.2.2", lambda w: f'If-Match: "a"\r\nIf-None-Match: {w.etag}\r\n', {412}),
    condition("If-Unmodified-Since, the same time", "RFC 9110 13.1.4", lambda w: f"If-Unmodified-Since: {gmtime(w.modified)}\r\n", {200}),
    condition("If-Unmodified-Since, earlier", "RFC 9110 13.1.4", lambda w: f"If-Unmodified-Since: {gmtime(w.modified - 1)}\r\n", {412}),
    condition("If-Unmodified-Since, no date", "RFC 9110 13.1.4", "If-Unmodified-Since: yesterday\r\n", {200}),
    condition("If-Match wins over If-Unmodified-Since", "RFC 9110 13.1.4", lambda w: f"If-Match: {w.etag}\r\nIf-Unmodified-Since: {gmtime(w.modified - 1)}\r\n", {200}),
    condition("Last-Modified is not after Date", "RFC 9110 8.8.2.1", "", {200},
              lambda answers, w: None if w.modified is not None and w.modified <= w.date else "Last-Modified is later"),
]


def ranged(first, last):
    """206 with the bytes and Content-Range, or 200 with all: a server may do without ranges (RFC 9110, 14.2)."""
    def check(answers, world):
        answer, whole = answers[0], world.plain.body
        if answer.status == 200:
            return body_is_whole(answers, world)
        begin, end = first(len(whole)), last(len(whole))
        if answer.body != whole[begin:end + 1]:
            return "not the bytes of the range"
        return field_is("Content-Range", f"bytes {begin}-{end}/{len(whole)}")(answers, world)
    return check


def unsatisfied(answers, world):
    if answers[0].status == 200:
        return body_is_whole(answers, world)
    return field_is("Content-Range", f"bytes */{len(world.plain.body)}")(answers, world)


def not_amplified(answers, world):
    return None if len(answers[0].body) <= 2 * len(world.plain.body) + 1000 else f"{len(answers[0].body)} bytes"


def accept_ranges_is_true(answers, world):
    """Accept-Ranges: bytes is a promise: a range then gives 206."""
    promised = world.plain.field("Accept-Ranges") == "bytes"
    return None if promised == (answers[0].status == 206) else "Accept-Ranges and the answer disagree"


MAYBE = {206, 200}
RANGES = [
    get("a range", "RFC 9110 14.1.2", "Range: bytes=10-99\r\n", MAYBE, ranged(lambda n: 10, lambda n: 99)),
    get("a range to the end", "RFC 9110 14.1.2", "Range: bytes=100-\r\n", MAYBE, ranged(lambda n: 100, lambda n: n - 1)),
    get("the last bytes", "RFC 9110 14.1.2", "Range: bytes=-10\r\n", MAYBE, ranged(lambda n: n - 10, lambda n: n - 1)),
    get("more last bytes than there are", "RFC 9110 14.1.2", "Range: bytes=-9999999\r\n", MAYBE, ranged(lambda n: 0, lambda n: n - 1)),
    get("a range beyond the end is cut", "RFC 9110 14.1.2", "Range: bytes=1-9999999\r\n", MAYBE, ranged(lambda n: 1, lambda n: n - 1)),
    get("a range with 30 digits", "RFC 9110 14.1.2", "Range: bytes=0-999999999999999999999999999999\r\n", {200, 206, 416}, not_amplified),
    get("no such range", "RFC 9110 15.5.17", "Range: bytes=9999999-\r\n", {416, 200}, unsatisfied),
    get("the last 0 bytes", "RFC 9110 14.1.2", "Range: bytes=-0\r\n", {416, 200}, unsatisfied),
    get("a backward range", "RFC 9110 14.1.1", "Range: bytes=9-1\r\n", {200, 416, 400}),
    get("a unit that nobody knows", "RFC 9110 14.2", "Range: tiles=1-2\r\n", {200}, body_is_whole),
    get("Range with HEAD", "RFC 9110 14.2", "Range: bytes=0-9\r\n", {200}, method="HEAD"),
    get("1,000 overlapping ranges", "RFC 9110 17.15", "Range: bytes=" + ",".join("0-" for _ in range(1000)) + "\r\n", {200, 206, 416, 400}, not_amplified),
    get("If-Range, the tag", "RFC 9110 13.1.5", lambda w: f"Range: bytes=0-9\r\nIf-Range: {w.etag}\r\n", MAYBE, ranged(lambda n: 0, lambda n: 9)),
    get("If-Range, another tag", "RFC 9110 13.1.5", 'Range: bytes=0-9\r\nIf-Range: "a"\r\n', {200}, body_is_whole),
    get("If-Range, a weak tag", "RFC 9110 13.1.5", lambda w: f"Range: bytes=0-9\r\nIf-Range: W/{w.etag}\r\n", {200}, body_is_whole),
    get("If-Range, an earlier date", "RFC 9110 13.1.5", lambda w: f"Range: bytes=0-9\r\nIf-Range: {gmtime(w.modified - 9)}\r\n", {200}, body_is_whole),
    get("If-None-Match comes before Range", "RFC 9110 13.2.2", lambda w: f"Range: bytes=0-9\r\nIf-None-Match: {w.etag}\r\n", {304}),
    get("Accept-Ranges says what is true", "RFC 9110 14.3", "Range: bytes=0-9\r\n", MAYBE, accept_ranges_is_true),
]

CODED, PLAIN = field_is("Content-Encoding", "gzip"), field_is("Content-Encoding", None)


def coding(name, value, check, **more):
    return get(f"Accept-Encoding: {name}", "RFC 9110 12.5.3", f"Accept-Encoding: {value}\r\n", more.pop("answers", {200}), every(check, body_is_whole), **more)


def readable(answers, world):
    return body_is_whole(answers, world) if answers[0].field("Content-Encoding") in (None, "gzip") else "a coding that was not asked for"


def vary(answers, world):
    return has_members("Vary", "Accept-Encoding")(answers, world)


def tags_differ(answers, _):
    return None if answers[0].field("ETag") != answers[1].field("ETag") else "one strong tag for two codings"


NEGOTIATION = [
    get("no Accept-Encoding", "RFC 9110 12.5.3", "", {200}, every(PLAIN, body_is_whole)),
    coding("gzip", "gzip", CODED),
    coding("GZIP", "GZIP", CODED),
    coding("x-gzip", "x-gzip", readable),
    coding("empty", "", PLAIN),
    coding("gzip;q=0", "gzip;q=0", PLAIN),
    coding("gzip;q=0.000, with blanks", "gzip ; q=0.000", PLAIN),
    coding("gzip;q=0.001", "gzip;q=0.001, identity;q=0", CODED),
    coding("identity;q=0", "identity;q=0, gzip", CODED),
    coding("unknown ones", "compress, br;q=0.9, exi", PLAIN),
    get("Accept-Encoding: *", "RFC 9110 12.5.3", "Accept-Encoding: *;q=0.5, zstd;q=0\r\n", {200}, readable),
    coding("*;q=0", "*;q=0", lambda a, w: readable(a, w) if a[0].status == 200 else None, answers={200, 406}),
    get("Accept-Encoding: the highest q", "RFC 9110 12.5.3", "Accept-Encoding: gzip;q=0.5, zstd\r\n", {200}, field_is("Content-Encoding", "zstd"), nginx=False),
    coding("two lines", "br\r\nAccept-Encoding: gzip", CODED),
    coding("empty members", ", ,gzip,", CODED),
    coding("malformed", ";;q=,=gzip\"", readable),
    coding("q above 1", "gzip;q=7", readable),
    coding("3,000 members", ",".join(["a"] * 3000), PLAIN),
    get("Vary in a plain answer", "RFC 9110 12.5.5", "", {200}, vary),
    get("Vary in a coded answer", "RFC 9110 12.5.5", "Accept-Encoding: gzip\r\n", {200}, vary),
    Case("codings have tags of their own", "RFC 9110 8.8.3.3", request() + request("Accept-Encoding: gzip\r\n"), [{200}, {200}], False, tags_differ),
    get("the tag of another coding", "RFC 9110 8.8.3.3", lambda w: f"Accept-Encoding: gzip\r\nIf-None-Match: {w.etag}\r\n", {200}),
    get("an Accept that excludes all", "RFC 9110 12.5.1", "Accept: image/png\r\n", {200, 406}),
    get("a malformed Accept", "RFC 9110 12.5.1", "Accept: ;;/,,=\"\r\n", {200, 400, 406}),
]

CACHES = [
    get("freshness is explicit", "RFC 9111 5.2.2", "", {200}, lambda a, _: None if re.search(r"(^|[ ,])max-age=[0-9]+($|[ ,;])", a[0].field("Cache-Control") or "") else
        f"Cache-Control is {a[0].field('Cache-Control')!r}"),
    get("Cache-Control in a request changes no bytes", "RFC 9111 5.2.1", "Cache-Control: no-cache\r\nPragma: no-cache\r\n", {200}, body_is_whole),
    get("Cache-Control: only-if-cached is for caches", "RFC 9111 5.2.1.7", "Cache-Control: only-if-cached\r\n", {200}, body_is_whole),
    get("no Age from an origin", "RFC 9111 5.1", "", {200}, field_is("Age", None)),
    get("one resource, one tag", "RFC 9110 8.8.3", "", {200}, lambda a, w: None if a[0].field("ETag") == w.etag else "the tag changed"),
]

PROBLEMS = [
    get("problem details of 404", "RFC 9457 3", "", {404}, is_problem, target=MISSING),
    Case("problem details of 405", "RFC 9457 3", request("Content-Length: 0\r\n", method="POST"), [{405}], None, is_problem),
    Case("problem details of 400", "RFC 9457 3", request(host=""), [{400}], True, is_problem),
    Case("problem details of 414", "RFC 9457 3", request(target="/" + "a" * 20000), [{414}], True, is_problem),
    Case("problem details of 501", "RFC 9457 3", request(method="BREW"), [{501}], None, is_problem),
    Case("problem details of 505", "RFC 9457 3", request(version="HTTP/2.0"), [{505}], None, is_problem),
    get("problem details are not for HEAD", "RFC 9110 9.3.2", "", {404}, no_body, target=MISSING, method="HEAD"),
]

CASES = METHODS + CONDITIONS + RANGES + NEGOTIATION + CACHES + PROBLEMS
