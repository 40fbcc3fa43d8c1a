"""Errors that the core raises on purpose: one clear line, naming the object and the remedy.

Everything a user can cause is a child of `RadiosityError`, so that an operator or a command line catches one class and
a programming error still shows its traceback.
"""


class RadiosityError(Exception):
    """Base of all errors whose text is meant for the user."""


class SettingsError(RadiosityError):
    """A setting is outside its range or names something that does not exist."""


class EmptySceneError(RadiosityError):
    """There is nothing to light: no mesh, no face, or none that is usable."""


class NoEmittersError(RadiosityError):
    """Nothing in the scene emits light."""


class SceneTooLargeError(RadiosityError):
    """The bake would take more memory than allowed; the text carries the numbers."""


class MissingRayEngineError(RadiosityError):
    """The embreex package, which traces the rays, cannot be imported on this platform."""


class SolverError(RadiosityError):
    """A system of equations is malformed or cannot be solved."""


class NeedsBakeError(RadiosityError):
    """What has changed since a bake cannot be brought up to date without a new one; the text names it."""
