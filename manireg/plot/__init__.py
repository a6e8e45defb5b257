"""Pictures for papers and notebooks: globes, cross-validation curves, coordinates,
residuals, meshes.

matplotlib comes with the extra `plots` and is imported when a picture is drawn, without
pyplot: figures carry no global state, show themselves in notebooks, and `save` writes
them for print. `page` alone needs plotly, of the extra `page`.
"""

from ._certificate import (
    certificate as certificate,
    page as page,
    page_library as page_library,
)
from ._charts import coordinates as coordinates, cv_curve as cv_curve
from ._figure import figure as figure, save as save
from ._globe import (
    Globe as Globe,
    globe as globe,
    view_of as view_of,
)
from ._residuals import residuals as residuals
from ._sphere_path import sphere_path as sphere_path
from ._surface import registration as registration, surface as surface
