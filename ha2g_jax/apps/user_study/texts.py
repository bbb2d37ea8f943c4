"""Texts of the report that do not depend on the answers: how each number is to be read."""

NOTHING = "No participant is left, so that there is nothing to analyse. The section Excluded has the reasons."

ONE_PARTICIPANT = "With one participant there are no intervals and no tests: nothing is known of other participants."

INTERVALS = """\
Intervals are of 95 % and about other participants and other clips: their variance is that over participants plus \
that over clips (jackknife), with the degrees of freedom of min F' (Clark 1973). They are rather too wide than too \
narrow. With one clip they are about other participants only; where all answers agree there is none."""

OPINION = "Means of all ratings."

DIFFERENCES = """\
First system less second, by least squares with an effect of each system, participant and clip: the difference of the \
means where every participant rates everything. p is of the hypothesis of no difference; "p, Holm" is corrected for \
all pairs of a scale, not for several scales."""

PREFERENCE = """\
Numbers of choices, and the share of the first system among the choices that prefer one, with the interval of Korn \
and Graubard (1998) over participants and clips. p is of a share of a half for the same sampling, "p, Holm" is \
corrected for all pairs. The exact p is of the binomial test, which treats all choices as independent; choices of one \
participant depend on each other, so that it is too small as a rule. Equal as half: the share if choices for neither \
count half."""

STRENGTHS = """\
Strengths of Bradley and Terry: with a difference d, the first system is preferred with probability 1 / (1 + exp(-d)) \
where one is preferred. Choices for neither do not count. Strengths are relative to their mean; 1500 on Elo's scale \
is that mean, and 400 points are odds of 10. Intervals are not corrected for the number of pairs."""

INFINITE = """\
Always or never preferred, at least to a group of the others, so that the answers set no bound on one side, and the \
value itself is due to the correction of the bias"""

MISSING = "Without a choice that prefers one, and therefore not in the table"

NO_PREFERENCE = "No choice prefers a system, so that there are no strengths."

NOT_CONNECTED = """\
The choices do not connect all systems with each other, directly or through others, so that there are no strengths on \
one scale."""

MISMATCH = """\
Participants saw the motion of a clip and the motion of another clip with the same sound, and chose which fits the \
speech. The share is of matched motion among the choices that prefer one; a half is what motion without relation to \
the speech reaches. Its interval (Korn and Graubard 1998) and p allow for choices that depend on the participant and \
on the clip; "p, Holm" is corrected for all systems. The exact p is of the binomial test, with the interval of \
Clopper and Pearson; they treat all choices as independent, and are too small and too narrow where participants \
differ. Equal as half: the share if choices for neither count half."""

AGREEMENT = """\
Agreement of participants on the same item beyond chance (Fleiss 1971): 0 is chance, 1 is perfect. Items with fewer \
than two answers do not count. The numbers of a scale are taken as names, so that 4 and 5 differ as much as 1 and 5: \
kappa of ratings is low as a rule."""

EXCLUDED = "These files are in none of the numbers."

COMMENTS = "Texts of participants, as they wrote them."
