"""Settings of one process: command line over environment (`LUXLOOP_*`) over `luxloop.toml` over the defaults."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Any, Self

from pydantic import Field, ValidationError, ValidationInfo, field_validator, model_validator
from pydantic_settings import BaseSettings, InitSettingsSource, PydanticBaseSettingsSource, SettingsConfigDict

from luxloop.endpoint import checked, fits
from luxloop.errors import InputError
from luxloop.files import read_text, toml_of
from luxloop.words import as_input_error

DEFAULT_ROUTER = "tcp/127.0.0.1:7447"
DEFAULT_SECURED = "tls/127.0.0.1:7447"
BEATS_IN_SILENCE = 3.0  # a beat may be late, and one may be lost
PROBE_BYTES = 1 << 16
FILE = Path("luxloop.toml")


class Settings(BaseSettings):
    """Where the router is, where things are kept, how patient this process is."""

    model_config = SettingsConfigDict(
        env_prefix="LUXLOOP_", env_ignore_empty=True, extra="forbid", frozen=True, validate_default=True,
        allow_inf_nan=False,
    )  # fmt: skip

    router: str = Field(DEFAULT_ROUTER, description="endpoint of the router")
    certs: Path | None = Field(None, description="folder of certificates (luxloop certs); none: plain tcp")
    realm: str = Field("luxloop", pattern=r"^[a-z0-9][a-z0-9-]{0,40}$", description="separates sets on one router")
    cache: Path = Field(Path("~/.cache/luxloop"), description="film database, stored arrays, compiled kernels")
    runs: Path = Field(Path("runs"), description="folder of the controller's runs, one folder each")
    effects: Path = Field(Path("effects"), description="folder of the user's own effects")
    heartbeat_s: float = Field(1.0, ge=0.01, le=10.0, description="how often a worker says how far it is")
    silence_s: float = Field(6.0, gt=0.0, le=600.0, description="a worker not heard for so long loses its task")
    attempts: int = Field(3, ge=1, le=20, description="how often a task is tried before it is set aside")
    queue_tasks: int = Field(100_000, ge=1, description="tasks waiting at the controller before it says busy")
    keep_results_mb: float = Field(256.0, ge=0.0, le=1e6, description="finished results kept for those who ask")

    @field_validator("router")
    @classmethod
    def _reachable(cls, router: str) -> str:
        return checked(router)

    @model_validator(mode="before")
    @classmethod
    def _encrypted_by_default(cls, given: dict[str, Any]) -> dict[str, Any]:
        """With certificates and no word about the router, it is at the usual port, but encrypted."""
        return given if given.get("certs") is None else {"router": DEFAULT_SECURED} | given

    @field_validator("cache", "runs", "effects", "certs")
    @classmethod
    def _somebodys(cls, folder: Path | None, field: ValidationInfo) -> Path | None:
        try:
            (folder or Path()).expanduser()
        except RuntimeError as error:  # ~nosuchuser
            mend = "name it without ~, or give it your own ~/"
            raise InputError(field.field_name or "", str(folder), "a folder", mend) from error
        return folder

    @model_validator(mode="after")
    def _certificates_fit_the_endpoint(self) -> Self:
        fits(self.router, self.certs is not None)
        return self

    @model_validator(mode="after")
    def _silence_outlasts_beats(self) -> Self:
        least_s = BEATS_IN_SILENCE * self.heartbeat_s
        if self.silence_s < least_s:
            mend = "a worker would be given up between two beats: raise silence_s or lower heartbeat_s"
            allowed = f"at least {BEATS_IN_SILENCE:g} x heartbeat_s = {least_s:g}"
            raise InputError("silence_s", self.silence_s, allowed, mend)
        return self

    @property
    def cache_dir(self) -> Path:
        """The cache folder with `~` expanded."""
        return self.cache.expanduser()

    @property
    def runs_dir(self) -> Path:
        """The folder of runs with `~` expanded."""
        return self.runs.expanduser()

    @property
    def effects_dir(self) -> Path:
        """The folder of the user's own effects with `~` expanded."""
        return self.effects.expanduser()

    @property
    def certs_dir(self) -> Path | None:
        """The folder of certificates with `~` expanded; None where everything is plain."""
        return self.certs.expanduser() if self.certs is not None else None

    @classmethod
    def settings_customise_sources(
        cls,
        settings_cls: type[BaseSettings],
        init_settings: PydanticBaseSettingsSource,
        env_settings: PydanticBaseSettingsSource,
        dotenv_settings: PydanticBaseSettingsSource,  # noqa: ARG003  no dotenv file is read
        file_secret_settings: PydanticBaseSettingsSource,  # noqa: ARG003  nor a folder of secrets
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        given = toml_of(read_text(FILE, FILE.name, "a TOML file"), FILE.name) if FILE.is_file() else {}
        return init_settings, env_settings, InitSettingsSource(settings_cls, given)


def load_settings(**given: object) -> Settings:
    """The settings, `given` (not None) over all else. Raises InputError naming the field and where it came from."""
    try:
        return Settings(**{key: value for key, value in given.items() if value is not None})  # type: ignore[arg-type]
    except ValidationError as error:
        raise as_input_error(error, "settings (command line, LUXLOOP_* or luxloop.toml)") from error
    except OSError as error:  # a folder that may not be looked into
        raise InputError(FILE.name, str(error), "a TOML file with the fields of the settings") from error


def usable_cache(settings: Settings) -> Path:
    """The cache folder, made where it was not there, after a file could be written into it.

    Raises InputError naming LUXLOOP_CACHE, the folder and what is wrong with it. A command asks before it starts
    anything: found out by a worker, the same would end as "no worker came".
    """
    return usable(settings.cache_dir, "LUXLOOP_CACHE", "set LUXLOOP_CACHE to another folder")


def usable(folder: Path, field: str, mend: str) -> Path:
    """A folder, made where it was not there, after a file could be written into it; else InputError by `field`."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as probe:
            probe.write(bytes(PROBE_BYTES))
    except (OSError, ValueError) as error:  # ValueError: a name that no file can have
        in_the_way = isinstance(error, FileExistsError | NotADirectoryError)
        why = "a file is in the way" if in_the_way else getattr(error, "strerror", None) or str(error)
        mend = f"{why}: mend that, or {mend}"
        raise InputError(field, str(folder), "a folder that can be made and written", mend) from error
    return folder


def as_environment(settings: Settings) -> dict[str, str]:
    """The environment for a child process that must see the same settings."""
    values = settings.model_dump(mode="json").items()
    ours = {f"LUXLOOP_{name.upper()}": "" if value is None else str(value) for name, value in values}
    return {**os.environ, **ours}
