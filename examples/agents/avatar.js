/**
 * Motion of `ha2g live` for an avatar in a page, tried with three-vrm 3.5.5 and TalkingHead 1.7.0.
 *
 *     ha2g live --source ws://127.0.0.1:8765 --rate 24000 --sink ws://127.0.0.1:8766 --rig vrm
 *
 * or, for TalkingHead, --rig mixamo. `--fps 60` sends frames between those of the model.
 */

const UPPER_BODY = /^(Spine|Neck|Head$|(Left|Right)(Shoulder|Arm|ForeArm|Hand))/; // TalkingHead moves the rest

/** The body of an agent. */
export class Body {
  #source;
  #bones = [];
  #rotations = [];

  /**
   * @param source - where `ha2g live` hears the agent.
   * @param sink - where it sends frames.
   */
  constructor(source = "ws://127.0.0.1:8765", sink = "ws://127.0.0.1:8766") {
    this.#source = new WebSocket(source);
    new WebSocket(sink).onmessage = ({ data }) => {
      const message = JSON.parse(data);
      if (message.type === "joints") this.#bones = message.joints.map(({ name }) => name.replace("mixamorig:", ""));
      else this.#rotations = message.rotations;
    };
  }

  /** Speaks: PCM of 16 bits, mono, at the rate of `--rate`, an `Int16Array` of any length. */
  say(pcm) {
    this.#source.send(pcm);
  }

  /** Changes what the body does: { state: "listen" }, { cue: "nod" }, { muted: true }, { clear: true }. */
  tell(message) {
    this.#source.send(JSON.stringify(message));
  }

  /** Poses an avatar of three-vrm; call it in each frame, before `vrm.update`. */
  poseVrm(vrm) {
    this.#each((name, rotation) => vrm.humanoid.getNormalizedBoneNode(name)?.quaternion.fromArray(rotation));
  }

  /** Poses an avatar of TalkingHead; call it in the option `update`. */
  poseTalkingHead(head) {
    this.#each((name, rotation) => {
      if (UPPER_BODY.test(name)) head.armature.getObjectByName(name)?.quaternion.fromArray(rotation);
    });
  }

  #each(pose) {
    this.#rotations.forEach((rotation, joint) => pose(this.#bones[joint], rotation));
  }
}
