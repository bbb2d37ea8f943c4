/** Styles to generate motion in: that of a speaker, of a mixture of speakers, given values, or a random one. */

/**
 * A requested style, by at most one of `speaker`, `mixture` and `values`; without any, it is drawn from the prior.
 */
export interface StyleOptions {
  /** Name of a speaker of the model. */
  speaker?: string;
  /** Name of a speaker -> weight; the weights are divided by their sum. */
  mixture?: Record<string, number>;
  /** (style_dim,) the values themselves. */
  values?: number[];
  /** Standard deviation of what the seed adds to the style of a speaker or a mixture, 0 to 2; 0.3 by default. */
  variation?: number;
}
