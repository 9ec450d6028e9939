-- SPDX-License-Identifier: GPL-3.0-or-later
-- wrk's script: asks for the addresses of a list in turn, over and over or once, and prints the figures as one line of JSON.
-- Arguments: LIST PIPELINE N_REQUESTS FIELD... ; a line of LIST is a path, perhaps a tab and an entity tag; N_REQUESTS 0: no end.

local ffi = require("ffi")
ffi.cdef [[
  typedef struct { long seconds, nanoseconds; } clock_reading;
  int clock_gettime(int clock, clock_reading* reading);
  int getpid();
  int kill(int pid, int signal);
]]

local requests, at, left = {}, 0, 0
local only_thread

local function now_s()
  local reading = ffi.new("clock_reading")
  ffi.C.clock_gettime(1, reading)  -- CLOCK_MONOTONIC
  return tonumber(reading.seconds) + tonumber(reading.nanoseconds) * 1e-9
end

function setup(thread)
  only_thread = thread
end

function init(args)
  local list, depth, limit = args[1], tonumber(args[2]), tonumber(args[3])
  local fields = {["Host"] = "tiles.example"}
  for k = 4, #args do
    local name, value = args[k]:match("^([^:]+): (.*)$")
    fields[name] = value
  end
  local batch = {}
  for line in io.lines(list) do
    local path, tag = line:match("^([^\t]+)\t(.*)$")
    if tag then fields["If-None-Match"] = tag end
    batch[#batch + 1] = wrk.format("GET", path or line, fields)
    if #batch == depth then
      requests[#requests + 1] = table.concat(batch)
      batch = {}
    end
  end
  began_s, took_s = 0, 0  -- global, so that done() gets at them
  left = limit > 0 and math.floor(limit / depth) or math.huge
end

function request()
  at = at % #requests + 1
  left = left - 1
  if began_s == 0 then began_s = now_s() end
  if left == 0 then
    took_s = now_s() - began_s
    wrk.thread:stop()
    ffi.C.kill(ffi.C.getpid(), 2)  -- SIGINT: else wrk waits for its whole time
  end
  return requests[at]
end

function done(summary, latency)
  local errors, took_s = summary.errors, only_thread:get("took_s")
  if took_s == 0 then took_s = summary.duration / 1e6 end
  io.write(string.format(
    '{"requests":%d,"duration_s":%.6f,"bytes":%d,"p50_us":%d,"p99_us":%d,"p999_us":%d,"failed":%d,"status_errors":%d}\n',
    summary.requests, took_s, summary.bytes, latency:percentile(50), latency:percentile(99),
    latency:percentile(99.9), errors.connect + errors.read + errors.write + errors.timeout, errors.status))
end
