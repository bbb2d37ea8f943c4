/**
 * Rotations of upper arm, forearm, hand and knuckles.
 *
 * The twist of a bone follows from the bend of the next bone, that of the forearm from the palm. At rest all bones lie
 * along the arm with the palm down, so that an elbow bends forward, a finger down, and the thumb lies in front. FORWARD
 * is the mark from which the twist of the arm is observed, and DOWN that of the fingers.
 */

import { fit } from "../fitting.js";
import { FOUR_FINGERS, LEFT } from "../rest.js";
import { about, between, conjugate, cross, dot, multiply, norms, rotate, unit, type Numbers } from "../rotations.js";
import { applyTwist, observe, plus, swing, type Twists } from "./twist.js";

/** Vectors or rotations over time by the name of a joint. */
export type ByJoint = Record<string, Numbers>;

export const FORWARD: Numbers = Float64Array.of(0, 0, 1);
const DOWN: Numbers = Float64Array.of(0, -1, 0);

/**
 * Weights of a twist that does not show. A joint bent at right angles has weight 1; the weight of a bend is the fourth
 * power of its sine, because the plane of a slight bend is uncertain.
 */
const HANGING = 2e-5;
const STRAIGHT = 3e-3;

/** A bend below the first sine may be a straight elbow that noise bends backward; one above the second is real. */
const SLIGHT: [number, number] = [0.34, 0.57];

/**
 * The twist of a forearm is 0 at the elbow and that of the hand at the wrist. As one bone it takes half of it. The
 * elbow has a little more weight than the hand, so that a hand twisted by 180 degrees gives a twist of 0.
 */
const ELBOW_WEIGHT = 1.1;

/**
 * Computes rotations in the world of the joints of one arm whose twist can be estimated.
 *
 * @param seen - (T x 3) unit vectors of the bones, by the name of the joint at their end.
 * @param rest - (3,) unit vectors of the same bones at rest.
 * @param trunk - (T x 4) rotations of the trunk.
 * @returns (T x 4) rotations by the name of the joint: shoulder, elbow and, with fingers, wrist and knuckles.
 */
export function armFrames(side: string, seen: ByJoint, rest: ByJoint, trunk: Numbers, twists: Twists): ByJoint {
  const out = side === "left" ? LEFT : LEFT.map((value) => -value);
  const upper = seen[`${side}_elbow`];
  const fore = seen[`${side}_wrist`];
  const shoulder = upperArm(`${side}_shoulder`, trunk, out, upper, fore, twists);
  const neutral = bendElbow(shoulder, out, fore);
  if (!(`${side}_index_1` in rest)) return { [`${side}_shoulder`]: shoulder, [`${side}_elbow`]: neutral };
  const bones = FOUR_FINGERS.map((finger) => `${side}_${finger}_1`);
  const palm = fit(bones.map((bone) => seen[bone]), bones.map((bone) => rest[bone]));
  const hand = handFrames(`${side}_wrist`, neutral, out, palm.fitted, palm.certainty, twists);
  const elbow = forearm(`${side}_elbow`, neutral, out, fore, hand, twists);
  const frames: ByJoint = { [`${side}_shoulder`]: shoulder, [`${side}_elbow`]: elbow, [`${side}_wrist`]: hand };
  for (const finger of FOUR_FINGERS) {
    const [first, second] = [seen[`${side}_${finger}_2`], seen[`${side}_${finger}_3`]];
    const joint = `${side}_${finger}_1`;
    frames[joint] = knuckle(joint, hand, out, first, second, twists);
  }
  return frames;
}

/** Rotates the upper arm so that the elbow bends forward; a straight arm as if raised from beside the trunk. */
function upperArm(
  joint: string,
  trunk: Numbers,
  out: Numbers,
  upper: Numbers,
  fore: Numbers,
  twists: Twists,
): Numbers {
  const frames = twists.transport(joint, trunk, out, upper);
  const hanging = multiply(trunk, between(out, DOWN));
  const front = rotate(swing(hanging, out, upper), FORWARD);
  const { across, sine } = bend(upper, fore);
  const ahead = dot(across, front);
  const weight = sine.map((value, k) => value ** 4 * (1 - (1 - step(value, ...SLIGHT)) * step(-ahead[k], -0.3, 0.2)));
  const seen = plus(observe(frames, out, FORWARD, across, weight), observe(frames, out, FORWARD, front, HANGING));
  return applyTwist(frames, out, twists.smooth(joint, seen));
}

/** Rotates the forearm without twist: bends it about the axis of the elbow, then swings it by the small remainder. */
function bendElbow(shoulder: Numbers, out: Numbers, fore: Numbers): Numbers {
  const local = rotate(conjugate(shoulder), fore);
  const along = dot(local, out);
  const angles = dot(local, FORWARD).map((value, k) => Math.atan2(value, along[k]));
  return swing(multiply(shoulder, about(cross(out, FORWARD), angles)), out, fore);
}

/** Rotates the hand as the palm where its bones are spread, and holds its twist where they are not. */
function handFrames(
  joint: string,
  neutral: Numbers,
  out: Numbers,
  palm: Numbers,
  certainty: Numbers,
  twists: Twists,
): Numbers {
  const frames = swing(neutral, out, rotate(palm, out));
  const weight = certainty.map((value) => value * value);
  const seen = observe(frames, out, FORWARD, rotate(palm, FORWARD), weight);
  return applyTwist(frames, out, twists.smooth(joint, plus(seen, HANGING)));
}

/**
 * Twists the forearm half-way from the elbow to the hand.
 *
 * A hand bends up and down about its axis to the thumb, which stays at right angles to the forearm, and only little to
 * the sides. So this axis shows the twist, however far the hand is bent.
 */
function forearm(joint: string, neutral: Numbers, out: Numbers, fore: Numbers, hand: Numbers, twists: Twists): Numbers {
  const thumb = rotate(hand, FORWARD);
  const squared = dot(thumb, fore).map((value) => 1 - value * value);
  const seen = plus(observe(neutral, out, FORWARD, thumb, 1), ELBOW_WEIGHT);
  const weighted = seen.map((value, k) => value * squared[k >> 1]);
  return applyTwist(neutral, out, twists.smooth(joint, plus(weighted, HANGING)));
}

/** Rotates the first bone of a finger so that the next joint, a hinge, bends towards the palm. */
function knuckle(joint: string, hand: Numbers, out: Numbers, first: Numbers, second: Numbers, twists: Twists): Numbers {
  const frames = swing(hand, out, first);
  const { across, sine } = bend(first, second);
  const palmward = dot(across, rotate(frames, DOWN));
  const weight = sine.map((value, k) => value ** 4 * step(palmward[k], 0, 0.5));
  const seen = observe(frames, out, DOWN, across, weight);
  return applyTwist(frames, out, twists.smooth(joint, plus(seen, STRAIGHT)));
}

/** Returns (T x 3) unit vectors across the first bone towards the second, and the (T) sines of the bend. */
function bend(first: Numbers, second: Numbers): { across: Numbers; sine: Numbers } {
  const along = dot(second, first);
  const across = second.map((value, k) => value - along[Math.floor(k / 3)] * first[k]);
  return { across: unit(across, 3), sine: norms(across, 3) };
}

/** Returns a smooth step that is 0 up to `low` and 1 from `high` on. */
function step(x: number, low: number, high: number): number {
  const fraction = Math.min(Math.max((x - low) / (high - low), 0), 1);
  return fraction * fraction * (3 - 2 * fraction);
}
