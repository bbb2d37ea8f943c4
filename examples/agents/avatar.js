/**
 * Motion of `ha2g live` for an avatar in a page, tried with three-vrm 3.5.5 and TalkingHead 1.7.0.
 *
 *     ha2g live --source ws://127.0.0.1:8765 --rate 24000 --sink ws://127.0.0.1:8766 --rig vrm
 *
 * or, for TalkingHead, --rig mixamo. `--fps 60` sends frames between those of the model.
 */

const RETRY_MILLISECONDS = 1000;
const REFUSAL_MILLISECONDS = 3000; // a source that hears another sender closes the connection within this time
const MOST_SAMPLES = 2 ** 18; // of a message, half of what the source takes
const STALE_MILLISECONDS = 10000; // after which a message that waits for the first connection is not sent
const UPPER_BODY = /^(Spine|Neck|Head$|(Left|Right)(Shoulder|Arm|ForeArm|Hand))/; // TalkingHead moves the rest

/** Opens a WebSocket, and again whenever it is closed; `begin` is called with each. */
function keepOpen(address, begin) {
  const socket = new WebSocket(address);
  begin(socket);
  socket.addEventListener("close", () => setTimeout(keepOpen, RETRY_MILLISECONDS, address, begin));
}

/** The body of an agent. */
export class Body {
  #source;
  #wasOpen = false;
  #waiting = []; // the latest messages and their times, until the source stays open for the first time
  #bones = [];
  #rotations = [];

  /**
   * @param source - where `ha2g live` hears the agent.
   * @param sink - where it sends frames.
   */
  constructor(source = "ws://127.0.0.1:8765", sink = "ws://127.0.0.1:8766") {
    keepOpen(source, (socket) => {
      this.#source = socket;
      socket.onopen = () => {
        this.#dropStale();
        this.#waiting.forEach(({ message }) => socket.send(message));
        setTimeout(() => {
          if (socket.readyState !== WebSocket.OPEN) return;
          this.#wasOpen = true;
          this.#waiting = [];
        }, REFUSAL_MILLISECONDS);
      };
    });
    keepOpen(sink, (socket) => {
      socket.onmessage = ({ data }) => {
        const message = JSON.parse(data);
        if (message.type === "joints") this.#bones = message.joints.map(({ name }) => name.replace("mixamorig:", ""));
        else this.#rotations = message.rotations;
      };
    });
  }

  /** Speaks: PCM of 16 bits, mono, at the rate of `--rate`, an `Int16Array` of any length. */
  say(pcm) {
    for (let first = 0; first < pcm.length; first += MOST_SAMPLES) this.#send(pcm.slice(first, first + MOST_SAMPLES));
  }

  /** Changes what the body does: { state: "listen" }, { cue: "nod" }, { muted: true }, { clear: true }. */
  tell(message) {
    this.#send(JSON.stringify(message));
  }

  #send(message) {
    if (this.#source.readyState === WebSocket.OPEN) this.#source.send(message);
    if (this.#wasOpen) return; // later it would be stale
    this.#dropStale();
    this.#waiting.push({ message, time: performance.now() });
  }

  #dropStale() {
    const oldest = performance.now() - STALE_MILLISECONDS;
    this.#waiting = this.#waiting.filter(({ time }) => time >= oldest);
  }

  /** Rotations x, y, z, w of all joints of the latest frame one after the other, empty before the first frame. */
  get pose() {
    return Float32Array.from(this.#rotations.flat());
  }

  /** Poses an avatar of three-vrm; call it in each frame, before `vrm.update`. */
  poseVrm(vrm) {
    const sign = vrm.meta.metaVersion === "0" ? -1 : 1; // in the normalized bones of VRM 0.x the figure faces -z
    this.#each((name, [x, y, z, w]) => {
      vrm.humanoid.getNormalizedBoneNode(name)?.quaternion.set(sign * x, y, sign * z, w);
    });
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
