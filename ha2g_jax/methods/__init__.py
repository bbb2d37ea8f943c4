"""The methods of the paper's tables, a file each: how its networks are built and run, and what its terms are."""

from ha2g_jax.methods import autoencoder, joint_embedding, seq2seq, speech2gesture, trimodal
from ha2g_jax.methods.ha2g import method as ha2g

METHODS = {
    "ha2g": ha2g.METHOD,
    "seq2seq": seq2seq.METHOD,
    "speech2gesture": speech2gesture.METHOD,
    "speech2gesture_legacy": speech2gesture.LEGACY,
    "joint_embedding": joint_embedding.METHOD,
    "trimodal": trimodal.METHOD,
    "autoencoder": autoencoder.METHOD,
}
