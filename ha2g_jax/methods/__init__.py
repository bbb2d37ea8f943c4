"""The methods of the paper's tables, each a module or package with the functions of `method.Method`."""

from ha2g_jax.methods import autoencoder, joint_embedding, seq2seq, speech2gesture, trimodal
from ha2g_jax.methods.ha2g import method as ha2g
from ha2g_jax.methods.method import GeneratingMethod, Method

METHODS: dict[str, GeneratingMethod] = {
    "ha2g": ha2g,
    "seq2seq": seq2seq,
    "speech2gesture": speech2gesture,
    "joint_embedding": joint_embedding,
    "trimodal": trimodal,
}
# The auto-encoder generates no motion from speech: it measures motion, see `ha2g_jax.evaluation`.
TRAINABLE: dict[str, Method] = {**METHODS, "autoencoder": autoencoder}
