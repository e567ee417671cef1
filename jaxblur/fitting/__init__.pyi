from .descent import (
    STAGES as STAGES,
    Progress as Progress,
    Stage as Stage,
    default_optimizer as default_optimizer,
)
from .pairs import Pair as Pair
from .profiles import Profile as Profile, profile as profile
from .result import (
    FilterChoice as FilterChoice,
    FitResult as FitResult,
    Score as Score,
    Sensitivity as Sensitivity,
    load_choice as load_choice,
)
from .run import fit as fit
from .search import SettingsSearch as SettingsSearch, search_settings as search_settings
