from .analysis import (
    Analysis as Analysis,
    Test as Test,
    agreement as agreement,
    agreement_test as agreement_test,
    analyze as analyze,
    circular_triads as circular_triads,
    consistency as consistency,
    equality_test as equality_test,
    equivalent_groups as equivalent_groups,
    least_significant_difference as least_significant_difference,
    preference as preference,
)
from .page import Options as Options, build_study as build_study
from .stimuli import Scene as Scene, Study as Study, read_study as read_study
from .votes import Votes as Votes, read_votes as read_votes
