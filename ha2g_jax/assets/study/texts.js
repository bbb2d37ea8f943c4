// What participants read. The scales are those of the paper's Table 2 and Appendix J, in our words.

export const SCALES = {
  naturalness: {
    name: "Naturalness",
    question: "Does the motion look like that of a real person, whatever is said?",
    help: "Odd angles of the arms or hands, and movements that no person makes, are not natural.",
  },
  smoothness: {
    name: "Smoothness",
    question: "Does the motion flow evenly over time, whatever is said?",
    help: "Jerks, stiff movements, and moments in which the figure seems stuck are not smooth.",
  },
  synchrony: {
    name: "Synchrony",
    question: "Does the motion fit the speech, both in its rhythm and in what is said?",
    help: "Gestures that come too early or too late, or that do not suit the words, are out of synchrony.",
  },
};
export const ENDS = ["not at all", "completely"];

export const PAIRS = {
  preference: { question: "Which motion do you prefer?", equal: "No preference" },
  mismatch: { question: "Which motion fits the speech better, in its rhythm and in what is said?", equal: "Both equally" },
};
export const CHECK = { name: "Number", question: "Which number does this clip ask you to choose?" };

export const PARTS = {
  rating: {
    title: "Rate clips",
    paragraphs: [
      "Each clip shows a figure that moves while a person speaks. Watch it to its end with sound, as often as you like, and give it a number from 1 to 5 on each scale. 5 is the best.",
      "Judge the motion alone. The figure is drawn simply, and its face does not move; this should not count.",
    ],
  },
  preference: {
    title: "Compare two motions",
    paragraphs: [
      "Two figures move to the same speech, which you hear once. Play them to their end, as often as you like, and choose the motion that you prefer. If neither is better, say so.",
    ],
  },
  mismatch: {
    title: "Find the motion that fits the speech",
    paragraphs: [
      "Two figures move while you hear one person speak. Play them to their end, as often as you like, and choose the motion that fits the speech better: its rhythm and emphasis, and what is said. Whether a motion is beautiful does not matter here.",
    ],
  },
};
export const ABOUT_CHECKS = "Some clips ask you, in writing and in speech, to choose a certain number. Please choose it; this shows us that the sound and the pictures reach you.";

const PLAY = ["Space", "play or pause"], NEXT = ["Enter", "go on"];
const NUMBERS = [["1 to 5", "choose a number, scale by scale"], ["Tab, arrow keys", "go to another scale, change a number"]];
const SIDES = [["←", "left"], ["→", "right"], ["↓", "equal"]];
export const KEYS = { rating: [PLAY, ...NUMBERS, NEXT], preference: [PLAY, ...SIDES, NEXT], mismatch: [PLAY, ...SIDES, NEXT] };
