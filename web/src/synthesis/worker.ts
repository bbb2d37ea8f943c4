/** The worker in which a model computes. */

export {};
