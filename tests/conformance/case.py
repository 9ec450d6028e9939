# SPDX-License-Identifier: GPL-3.0-or-later
"""What a case of the conformance list is, and the words it is written in."""
import dataclasses
import email.utils
import gzip
import json
import re
import time
from typing import Callable, Optional

TILE = "/world/1/1/1.terrain"   # a resource that both servers have, of some kilobytes, coded in gzip on request
OTHER = "/world/1/2/1.terrain"  # another one, with other bytes
CLOSE = "Connection: close\r\n"


@dataclasses.dataclass
class Case:
    """Bytes to send and what a right server answers.

    answers: for each answer the allowed status codes, in order; an empty list: the connection closes without any.
    tind: the same, narrower, for the daemon, whose docs/http.md says more than the RFC does.
    closes: True: the connection closes then, and nothing more comes before; False: it stays open; None: not looked at.
    check: called with the answers and the world; gives None or what is wrong.
    """
    name: str
    rfc: str
    send: object  # bytes, or a function of the world that gives bytes
    answers: list
    closes: Optional[bool] = None
    check: Optional[Callable] = None
    tind: Optional[list] = None
    methods: tuple = ()
    byte_by_byte: bool = False
    half_close: bool = False
    nginx: bool = True  # False: about something that a folder of files does not have


def request(fields="", target=TILE, method="GET", host="Host: h\r\n", version="HTTP/1.1", body=b""):
    return f"{method} {target} {version}\r\n{host}{fields}\r\n".encode("latin-1") + body


def get(name, rfc, fields, answers, check=None, **more):
    """A GET (or `method`) on a connection that stays open, with fields in bytes, text, or a function of the world."""
    method, target = more.pop("method", "GET"), more.pop("target", TILE)

    def send(world):
        text = fields(world) if callable(fields) else fields
        return request(text, target, method)
    return Case(name, rfc, send, [answers], check=check, methods=(method,), **more)


# -- checks: functions of (answers, world) that give None or a complaint

def every(*checks):
    return lambda answers, world: next((text for text in (check(answers, world) for check in checks) if text), None)


def field_is(name, value):
    """`value`: text, or None for an absent field."""
    def check(answers, _):
        got = answers[0].field(name)
        return None if got == value else f"{name} is {got!r}, not {value!r}"
    return check


def field_matches(name, pattern):
    def check(answers, _):
        got = answers[0].field(name)
        return None if got is not None and re.fullmatch(pattern, got) else f"{name} is {got!r}"
    return check


def has_members(name, *members):
    """A list field, perhaps in several lines, that has all these members."""
    def check(answers, _):
        have = {word.strip().lower() for value in answers[0].all(name) for word in value.split(",")}
        missing = [member for member in members if member.lower() not in have]
        return f"{name} lacks {', '.join(missing)}" if missing else None
    return check


def body_is_whole(answers, world):
    """The body, uncoded, is the resource's."""
    for answer in answers:
        if answer.status == 200 and decoded(answer) != world.identity[TILE]:
            return "the body is not the resource"
    return None


def decoded(answer):
    coding = answer.field("Content-Encoding")
    if coding is None or coding == "identity":
        return answer.body
    if coding in ("gzip", "x-gzip"):
        return gzip.decompress(answer.body)
    return f"a body in {coding}"


def no_body(answers, _):
    return "there is a body" if answers[0].body else None


def in_order(answers, world):
    bodies = [decoded(answer) for answer in answers if answer.status == 200]
    wanted = [world.identity[target] for target in (TILE, OTHER, TILE)][:len(bodies)]
    return None if bodies == wanted else "the answers are not in the order of the requests"


IMF = r"(Mon|Tue|Wed|Thu|Fri|Sat|Sun), [0-3][0-9] (Jan|Feb|Mar|Apr|May|Jun|Jul|Aug|Sep|Oct|Nov|Dec) [0-9]{4} [0-2][0-9]:[0-5][0-9]:[0-6][0-9] GMT"


def date_is_now(answers, _):
    value = answers[0].field("Date")
    if value is None or not re.fullmatch(IMF, value):
        return f"Date is {value!r}"
    apart_s = abs(email.utils.parsedate_to_datetime(value).timestamp() - time.time())
    return None if apart_s < 5 else f"Date is {apart_s:.0f} s off"


def is_problem(answers, _):
    """Problem details (RFC 9457, 3): the type, and members of the right types that agree with the status."""
    answer = answers[0]
    if answer.field("Content-Type") != "application/problem+json":
        return f"Content-Type is {answer.field('Content-Type')!r}"
    try:
        problem = json.loads(answer.body)
    except ValueError:
        return "the body is not JSON"
    if problem.get("status") != answer.status:
        return f"status in the body is {problem.get('status')!r}"
    if any(not isinstance(problem.get(name, ""), str) for name in ("type", "title", "detail", "instance")):
        return "a member is not a string"
    return None if "title" in problem else "no title"


def gmtime(seconds, form="imf"):
    """The three formats of RFC 9110, 5.6.7."""
    parts = time.gmtime(seconds)
    return time.strftime({"imf": "%a, %d %b %Y %H:%M:%S GMT", "rfc850": "%A, %d-%b-%y %H:%M:%S GMT",
                          "asctime": "%a %b "}[form], parts) + \
        (f"{parts.tm_mday:2d} " + time.strftime("%H:%M:%S %Y", parts) if form == "asctime" else "")
