"""Settings of one process: command line over environment (`LUXLOOP_*`) over `luxloop.toml` over the defaults."""

from __future__ import annotations

import os
from pathlib import Path

from pydantic import Field, ValidationError
from pydantic_settings import (
    BaseSettings,
    PydanticBaseSettingsSource,
    SettingsConfigDict,
    TomlConfigSettingsSource,
)

from luxloop.errors import InputError
from luxloop.words import as_input_error

DEFAULT_ROUTER = "tcp/127.0.0.1:7447"


class Settings(BaseSettings):
    """Where the router is, where things are kept, how patient this process is."""

    model_config = SettingsConfigDict(
        env_prefix="LUXLOOP_", toml_file="luxloop.toml", extra="forbid", frozen=True, validate_default=True
    )

    router: str = Field(DEFAULT_ROUTER, pattern=r"^(tcp|tls)/.+:\d{1,5}$", description="endpoint of the router")
    realm: str = Field("luxloop", pattern=r"^[a-z0-9][a-z0-9-]{0,40}$", description="separates sets on one router")
    cache: Path = Field(Path("~/.cache/luxloop"), description="film database, stored arrays, compiled kernels")
    effects: Path = Field(Path("effects"), description="folder of the user's own effects")
    heartbeat_s: float = Field(1.0, gt=0.0, le=10.0, description="how often a worker says how far it is")
    silence_s: float = Field(6.0, gt=0.0, le=600.0, description="a worker not heard for so long loses its task")
    attempts: int = Field(3, ge=1, le=20, description="how often a task is tried before it is set aside")
    queue_tasks: int = Field(100_000, ge=1, description="tasks waiting at the controller before it says busy")
    keep_results_mb: float = Field(256.0, ge=0.0, description="finished results the controller keeps for askers")

    @property
    def cache_dir(self) -> Path:
        """The cache folder with `~` expanded."""
        return self.cache.expanduser()

    @classmethod
    def settings_customise_sources(
        cls,
        settings_cls: type[BaseSettings],
        init_settings: PydanticBaseSettingsSource,
        env_settings: PydanticBaseSettingsSource,
        dotenv_settings: PydanticBaseSettingsSource,  # noqa: ARG003  no dotenv file is read
        file_secret_settings: PydanticBaseSettingsSource,  # noqa: ARG003  nor a folder of secrets
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        return init_settings, env_settings, TomlConfigSettingsSource(settings_cls)


def load_settings(**given: object) -> Settings:
    """The settings, `given` (not None) over all else. Raises InputError naming the field and where it came from."""
    try:
        return Settings(**{key: value for key, value in given.items() if value is not None})  # type: ignore[arg-type]
    except ValidationError as error:
        raise as_input_error(error, "settings (command line, LUXLOOP_* or luxloop.toml)") from error
    except (OSError, ValueError) as error:
        raise InputError("luxloop.toml", str(error), "a TOML file with the fields of the settings") from error


def as_environment(settings: Settings) -> dict[str, str]:
    """The environment for a child process that must see the same settings."""
    ours = {f"LUXLOOP_{name.upper()}": str(value) for name, value in settings.model_dump(mode="json").items()}
    return {**os.environ, **ours}
