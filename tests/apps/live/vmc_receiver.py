"""Print what vmcp, a receiver of the VMC protocol of another project, reads: `python vmc_receiver.py PORT`.

A line "ready" comes when it listens; then, after the bones of one frame, a line of JSON with the position and rotation
of the root and of every bone by its name.
"""

import json
import sys
import time

from vmcp.events import BoneTransformEvent, RootTransformEvent
from vmcp.facades import on_receive
from vmcp.osc import OSC
from vmcp.osc.backend.osc4py3 import as_eventloop

_LAST_BONE = "RightToes"
_SECONDS = 20

found = {}


def receive(event):
    name = event.joint if isinstance(event.joint, str) else event.joint.value
    position, rotation = event.position, event.rotation
    found[name] = [[position.x, position.y, position.z], [rotation.x, rotation.y, rotation.z, rotation.w]]


osc = OSC(as_eventloop)
with osc.open():
    receiver = osc.create_receiver("127.0.0.1", int(sys.argv[1]), "receiver").open()
    on_receive(receiver, RootTransformEvent, receive)
    on_receive(receiver, BoneTransformEvent, receive)
    osc.run()
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    end = time.monotonic() + _SECONDS
    while time.monotonic() < end and _LAST_BONE not in found:
        osc.run()
        time.sleep(0.005)
    sys.stdout.write(json.dumps(found) + "\n")
osc.close()
