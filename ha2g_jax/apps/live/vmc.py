"""Sink for the VMC protocol: OSC messages over UDP that move a VRM or Unity humanoid (protocol.vmc.info).

Axes are those of Unity: left-handed, metres, y up, the figure faces +z, its left is at -x. Bones have the names of
Unity's HumanBodyBones; positions and rotations are relative to the parent, and a rotation is the identity in the
T-pose.
"""

from collections.abc import Iterator

import numpy as np

from ha2g_jax.apps.live.addresses import Address, import_extra, udp_target
from ha2g_jax.apps.live.frames import Frame

PORT = 39539
RIG = "unity"
MAX_DATAGRAM = 1400  # bytes; a longer one is cut into packets on most networks, and lost as a whole with any of them

_MIRROR_X = np.array([-1.0, 1.0, 1.0])
_MIRROR_ROTATION = np.array([1.0, -1.0, -1.0, 1.0])
_HEADER, _SIZE = 16, 4  # bytes of a bundle, and of the size of a message in it


class VmcSink:
    """Sender of frames to a receiver of the VMC protocol.

    Attributes:
        name: its address, for messages.
        rig: name of the rig of its frames.
    """

    rig = RIG

    def __init__(self, address: Address) -> None:
        """Prepare a socket; nothing is sent yet.

        Args:
            address: where the receiver listens.

        Raises:
            UserError: the host is not known, or the library is missing.
        """
        self._messages = import_extra("pythonosc.osc_message_builder", "python-osc")
        self._bundles = import_extra("pythonosc.osc_bundle_builder", "python-osc")
        self.name = str(address)
        self._socket, self._target = udp_target(address)

    def send(self, frame: Frame) -> None:
        """Send /VMC/Ext/OK, /VMC/Ext/T, /VMC/Ext/Root/Pos and a /VMC/Ext/Bone/Pos for each bone.

        Args:
            frame: frame with the rig `unity`.
        """
        for datagram in self._datagrams(frame):
            self._socket.sendto(datagram, self._target)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def _datagrams(self, frame: Frame) -> Iterator[bytes]:
        """Yield bundles of at most `MAX_DATAGRAM` bytes."""
        messages, size = [], _HEADER
        for message in self._frame_messages(frame):
            if messages and size + _SIZE + message.size > MAX_DATAGRAM:
                yield self._bundle(messages)
                messages, size = [], _HEADER
            messages.append(message)
            size += _SIZE + message.size
        yield self._bundle(messages)

    def _frame_messages(self, frame: Frame) -> Iterator:
        animation = frame.animations[RIG]
        armature = animation.armature
        yield self._message("/VMC/Ext/OK", 1)
        yield self._message("/VMC/Ext/T", float(frame.seconds))
        yield self._message("/VMC/Ext/Root/Pos", "root", *(0.0, 0.0, 0.0), *(0.0, 0.0, 0.0, 1.0))
        positions = np.concatenate([animation.translation, armature.offsets[1:]]) * _MIRROR_X + 0.0
        rotations = animation.rotations[0] * _MIRROR_ROTATION + 0.0
        for name, position, rotation in zip(armature.joints, positions.tolist(), rotations.tolist(), strict=True):
            yield self._message("/VMC/Ext/Bone/Pos", name, *position, *rotation)

    def _message(self, address: str, *values: int | float | str):
        builder = self._messages.OscMessageBuilder(address)
        for value in values:
            builder.add_arg(value)
        return builder.build()

    def _bundle(self, messages: list) -> bytes:
        builder = self._bundles.OscBundleBuilder(self._bundles.IMMEDIATELY)
        for message in messages:
            builder.add_content(message)
        return builder.build().dgram
