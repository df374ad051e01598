"""What an agent has learned, as JSON, and back to the last bit.

`formation.agent.core.CoreState` contains all of it. Pydantic validates and writes it by schemas made from the
annotations of the state's dataclasses: a complex number is [x, y], a named tuple a list, and a float that is
not finite a word. Every field must be present, and no other.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cache
from types import MappingProxyType, NoneType, UnionType
from typing import Any, Generic, TypeVar, Union, get_args, get_origin, get_type_hints

from pydantic import TypeAdapter
from pydantic_core import (
    CoreConfig,
    CoreSchema,
    SchemaSerializer,
    SchemaValidator,
    ValidationError,
    from_json,
)
from pydantic_core import core_schema as schemas

from formation.agent.core import Agent, CoreState
from formation.agent.following.gains import TuningState
from formation.agent.following.relative_check import RelativeMemory
from formation.agent.pose.estimator import LocalisationState
from formation.agent.pose.motion_check import MotionMemory
from formation.agent.safety.latch import LatchState
from formation.agent.safety.scanner import ScanMemory
from formation.protocol.reasons import Reason
from formation.ros2.messages import Message

Json = Any
"""None, bool, int, float, str, and lists and dicts of these."""
_CONFIG = CoreConfig(ser_json_inf_nan="strings", extra_fields_behavior="forbid")
_WORDS = {"Infinity": math.inf, "-Infinity": -math.inf, "NaN": math.nan}

_REAL = schemas.union_schema(
    [
        schemas.float_schema(strict=True, allow_inf_nan=False),
        schemas.no_info_after_validator_function(_WORDS.__getitem__, schemas.literal_schema(list(_WORDS))),
    ],
    custom_error_type="real",
    custom_error_message=f"must be a number, or one of {', '.join(_WORDS)}",
    serialization=schemas.simple_ser_schema("float"),
    ref="real",
)
_A_REAL = schemas.definition_reference_schema("real")  # so that one validator serves all of them
_PAIR = schemas.tuple_positional_schema([_A_REAL, _A_REAL])
_TEXT = schemas.str_schema(strict=True)
_LEAVES: Mapping[Any, CoreSchema] = {
    bool: schemas.bool_schema(strict=True),
    int: schemas.int_schema(strict=True, ge=0, lt=2**63),
    float: _A_REAL,
    str: _TEXT,
    complex: schemas.no_info_after_validator_function(
        lambda parts: complex(*parts),
        _PAIR,
        serialization=schemas.plain_serializer_function_ser_schema(
            lambda value: (value.real, value.imag), return_schema=_PAIR
        ),
    ),
    Reason: schemas.no_info_after_validator_function(
        lambda parts: Reason.read(*parts),
        schemas.tuple_positional_schema([_TEXT, schemas.dict_schema(_TEXT)]),
        serialization=schemas.plain_serializer_function_ser_schema(lambda one: (one.code, dict(one.values))),
    ),
}


@cache
def _schema(of: Any) -> CoreSchema:
    if of in _LEAVES:
        return _LEAVES[of]
    origin, args = get_origin(of), get_args(of)
    if origin in {Union, UnionType}:
        first, *others = (_schema(one) for one in args if one is not NoneType)
        schema = schemas.union_schema([first, *others]) if others else first
        return schemas.nullable_schema(schema) if NoneType in args else schema
    if origin is tuple:
        return _tuple(args)
    if origin in {list, deque}:
        return _made(origin, schemas.list_schema(_schema(args[0])), list)
    if origin in {dict, Counter, Mapping}:
        values = _schema(int if origin is Counter else args[1])
        made = MappingProxyType if origin is Mapping else origin
        return _made(made, schemas.dict_schema(_TEXT, values), dict)
    return _record(of)


def _tuple(args: Sequence[Any]) -> CoreSchema:
    if args[1:] == (...,):
        return schemas.tuple_variable_schema(_schema(args[0]))
    return schemas.tuple_positional_schema([_schema(one) for one in args])


def _made(of: Any, schema: CoreSchema, plain: type) -> CoreSchema:
    """`of` what `schema` reads; written as `plain`."""
    if of is plain:
        return schema
    serialization = schemas.plain_serializer_function_ser_schema(plain, return_schema=schema)
    return schemas.no_info_after_validator_function(of, schema, serialization=serialization)


def _record(of: Any) -> CoreSchema:
    """A named tuple, a dataclass, or what pydantic knows: a model, an enumeration, words."""
    if not isinstance(of, type) or not (is_dataclass(of) or issubclass(of, tuple)):
        return TypeAdapter(of).core_schema
    hints = get_type_hints(of)
    if issubclass(of, tuple):
        return schemas.no_info_after_validator_function(lambda row: of(*row), _tuple([*hints.values()]))
    names = [one.name for one in fields(of)]
    known = [schemas.dataclass_field(name, _schema(hints[name])) for name in names]
    body = schemas.dataclass_args_schema(of.__name__, known)
    return schemas.dataclass_schema(of, body, names, slots=True, config=_CONFIG)


class BadStateError(ValueError):
    """Not the state of such an agent; the text names the place and what is wrong there."""


T = TypeVar("T")


class Codec(Generic[T]):
    """Writes and reads one dataclass."""

    def __init__(self, of: type[T]) -> None:
        annotation: Any = of
        schema = schemas.definitions_schema(_schema(annotation), [_REAL])
        self._writer, self._reader = SchemaSerializer(schema, _CONFIG), SchemaValidator(schema, _CONFIG)

    def write(self, state: T) -> Json:
        """Return it as JSON."""
        return from_json(self._writer.to_json(state, warnings=False))

    def read(self, data: Json | bytes, where: str = "") -> T:
        """Read JSON, as text or parsed, from a place that errors name. Raises BadStateError."""
        try:
            read = self._reader.validate_json if isinstance(data, bytes) else self._reader.validate_python
            state: T = read(data)
        except ValidationError as error:
            raise BadStateError(explained(error, where)) from None
        return state


def explained(error: ValidationError, where: str = "") -> str:
    """The first place that is wrong, from `where` on, and what is expected there; one line."""
    first = error.errors(include_url=False, include_input=False, include_context=False)[0]
    place = ".".join(map(str, (where, *first["loc"]) if where else first["loc"]))
    return " ".join(f"{place + ': ' if place else ''}{first['msg']}".split())


_AGENT = Codec(CoreState)


def dump(agent: Agent) -> Json:
    """Return the agent's state as JSON."""
    return _AGENT.write(agent.state)


def restore(agent: Agent, saved: Json) -> None:
    """Have `agent` continue from the state of one with the same mission, robot, law and publisher id.

    Raises BadStateError for what is no state of such an agent; `agent` is then unchanged.
    """
    state = _AGENT.read(saved, "state")
    _check(agent, state)
    overwrite(agent.state, state)


def overwrite(state: Any, by: Any) -> None:
    """Give a state the values of another of its type, in place: the parts of an agent refer to it."""
    for name in [one.name for one in fields(state)]:
        ours, theirs = getattr(state, name), getattr(by, name)
        if _is_state(ours) and type(theirs) is type(ours):
            overwrite(ours, theirs)
        elif isinstance(ours, dict) and any(map(_is_state, ours.values())):
            for part in ours:
                overwrite(ours[part], theirs[part])
        else:
            setattr(state, name, theirs)


def _is_state(value: Any) -> bool:
    return is_dataclass(value) and not isinstance(value, Message)


@dataclass(slots=True, kw_only=True)
class Restored:
    """What an agent takes over from another process; None for what stays as it is."""

    latch: LatchState | None = None
    voted_term: int | None = None
    """The voted term."""
    here: LocalisationState | None = None
    integral: complex | None = None
    tuning: TuningState | None = None
    motion: MotionMemory | None = None
    """How the robot's motion differed from its commands."""
    tries: int = 0
    """Number of probes since it was last seen to move."""
    scans: ScanMemory | None = None
    relative: dict[str, RelativeMemory] | None = None
    """By neighbour that a sensor measures."""
    lost_locks: list[float] | None = None
    """Path since scans contradicted where the robot took itself to be [m]."""

    def into(self, agent: Agent) -> None:
        """Have `agent` take it over. Raises BadStateError; `agent` is then unchanged."""
        now, motion = agent.state, self.motion
        state = replace(
            now,
            latch=self.latch or now.latch,
            here=self.here or now.here,
            integral=now.integral if self.integral is None else self.integral,
            tuning=self.tuning or now.tuning,
            motion=now.motion if motion is None else replace(now.motion, doubt=motion.doubt, earlier=motion),
            probe=replace(now.probe, tries=self.tries or now.probe.tries),
        )
        _check(agent, state)
        if self.voted_term is not None:
            state.orders.voter.voted_term = self.voted_term
        overwrite(now, state)
        if self.scans is not None and agent.avoiding.scanner is not None:
            agent.avoiding.scanner.restore(self.scans)
        agent.neighbours.restore(self.relative or {})
        if self.lost_locks and agent.perception is not None:
            agent.perception.restore(self.lost_locks)


RESTORED = Codec(Restored)


def _check(agent: Agent, state: CoreState) -> None:
    """Raise BadStateError for the state of another robot or mission."""
    own = agent.state
    seen = {} if own.perception is None else own.perception.mates
    found = seen if state.perception is None else state.perception.mates
    for where, ours, theirs in (
        ("perception.mates", seen, found),
        ("neighbours.each", own.neighbours.each, state.neighbours.each),
        ("avoiding.others", own.avoiding.others, state.avoiding.others),
        ("slots.at", own.slots.at, state.slots.at),
        ("slots.velocity", own.slots.velocity, state.slots.velocity),
        ("slots.ordered", own.slots.ordered, state.slots.ordered),
        ("slots.going", own.slots.going, state.slots.going),
    ):
        if odd := sorted(set(ours).symmetric_difference(theirs)):
            what = "is missing" if odd[0] in ours else "is unknown to this agent"
            raise BadStateError(f"state.{where}.{odd[0]}: {what}")
    if type(own.here.source) is not type(state.here.source):
        raise BadStateError("state.here.source: is of another localisation")
    if (own.avoiding.scanner is None) != (state.avoiding.scanner is None):
        raise BadStateError("state.avoiding.scanner: must be null exactly for a robot without a scanner")
    if (own.perception is None) != (state.perception is None):
        raise BadStateError("state.perception: must be null exactly for a robot that sees no neighbours")
