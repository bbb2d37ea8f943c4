/** Returns the minimum-jerk curve, which goes from 0 to 1 and is at rest at both ends (Flash and Hogan 1985). */
export function minimumJerk(time: number): number {
  return time ** 3 * (10 - 15 * time + 6 * time ** 2);
}
