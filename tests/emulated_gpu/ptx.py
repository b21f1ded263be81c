"""Translation of the PTX that Dr.Jit writes into C: a function for each entry and callable, which runs one lane.

A lane is a warp of its own: votes, shuffles and matches see that lane alone. What an instruction does, NVIDIA's "PTX
ISA" says; which of them Dr.Jit writes, drjit-core's src/cuda_eval.cpp. Any other is `Untranslatable`.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

_STATEMENT = re.compile(r"\s*(?:(?P<label>\w+):|(?P<brace>[{}])|(?P<text>[^;{}\s][^;{}]*(?:\{[^{}]*\}[^;{}]*)*);)")
_FUNCTION = re.compile(r"\.(entry|func)\s*(?:\([^)]*\)\s*)?(\w+)\s*\(([^)]*)\)\s*")
_TABLE = re.compile(r"\.visible\s+\.global[^=;]*callables\[\d+\]\s*=\s*\{([^}]*)\};?")
_ADDRESS = re.compile(r"(\w*)\[([%\w]+)(?:\s*\+\s*(\d+))?\]")
_COMMA = re.compile(r",\s*(?![^({\[]*[)}\]])")
_IMMEDIATE = re.compile(r"~?-?\d+(\.\d*)?|0[xXfFdD][0-9A-Fa-f]+")
_USED = re.compile(r"\b(r_\w+)\.")
_PARAMETERS = ("index", "self", "data", "base")
_ARGUMENTS = ", u8 *result, const u8 *params, u32 index, u32 self, u64 data, u64 base"
_SPECIAL = {
    "%ctaid.x": "0", "%ntid.x": "1", "%tid.x": "lane->index", "%laneid": "0", "%lanemask_lt": "0", "%lanemask_le": "1",
    "%lanemask_gt": "0xfffffffe",
}  # fmt: skip

# {x[0]}, {x[1]}: operands, read as the instruction's type {t} of {bits} bits; {u[1]}: as a number of 32 bits.
_INTEGER = {
    "add": "{x[0]} + {x[1]}", "sub": "{x[0]} - {x[1]}", "mul": "{x[0]} * {x[1]}", "mad": "{x[0]} * {x[1]} + {x[2]}",
    "div": "{x[1]} ? {x[0]} / {x[1]} : ({t})-1", "rem": "{x[1]} ? {x[0]} % {x[1]} : {x[0]}",
    "neg": "-{x[0]}", "abs": "{x[0]} < 0 ? -{x[0]} : {x[0]}",
    "min": "{x[0]} < {x[1]} ? {x[0]} : {x[1]}", "max": "{x[0]} > {x[1]} ? {x[0]} : {x[1]}",
    "not": "~{x[0]}", "and": "{x[0]} & {x[1]}", "or": "{x[0]} | {x[1]}", "xor": "{x[0]} ^ {x[1]}",
    "shl": "{u[1]} < {bits} ? {x[0]} << {u[1]} : 0", "shr": "{u[1]} < {bits} ? {x[0]} >> {u[1]} : -({x[0]} < 0)",
    "bfe": "{x[0]} >> {u[1]} & (((u64)1 << {u[2]}) - 1)", "brev": "reversed({x[0]}, {bits})",
    "popc": "population({x[0]})", "clz": "leading_zeros({x[0]}, {bits})",
    "bfind": "{x[0]} ? leading_zeros({x[0]}, {bits}) : -1",
    "mov": "{x[0]}", "shfl": "{x[0]}", "vote": "{x[0]}", "activemask": "1", "match": "1",
}  # fmt: skip
_FLOAT = {
    "add": "{x[0]} + {x[1]}", "sub": "{x[0]} - {x[1]}", "mul": "{x[0]} * {x[1]}", "div": "{x[0]} / {x[1]}",
    "fma": "fma{f}({x[0]}, {x[1]}, {x[2]})", "neg": "-{x[0]}", "abs": "fabs{f}({x[0]})", "mov": "{x[0]}",
    "min": "fmin{f}({x[0]}, {x[1]})", "max": "fmax{f}({x[0]}, {x[1]})", "copysign": "copysign{f}({x[1]}, {x[0]})",
    "sqrt": "sqrt{f}({x[0]})", "rsqrt": "1 / sqrt{f}({x[0]})", "rcp": "1 / {x[0]}", "sin": "sin{f}({x[0]})",
    "cos": "cos{f}({x[0]})", "ex2": "exp2{f}({x[0]})", "lg2": "log2{f}({x[0]})", "tanh": "tanh{f}({x[0]})",
}  # fmt: skip
# Largest errors of `.approx`: sin and cos 2^-20.5; lg2 2^-22 within 1/2 to 2, elsewhere that share of the result.
_ABSOLUTE_ERRORS = {"sin": "6.7e-7f", "cos": "6.7e-7f", "lg2": "0x1p-22f * fmaxf(1, fabsf({}))"}
_COMPARISONS = {
    "eq": "{0} == {1}", "ne": "{0} < {1} || {0} > {1}", "lt": "{0} < {1}", "lo": "{0} < {1}", "le": "{0} <= {1}",
    "ls": "{0} <= {1}", "gt": "{0} > {1}", "hi": "{0} > {1}", "ge": "{0} >= {1}", "hs": "{0} >= {1}",
    "nan": "{0} != {0} || {1} != {1}", "num": "{0} == {0} && {1} == {1}",
}  # fmt: skip
_ATOMIC = {
    "add": "old + {0}", "min": "old < {0} ? old : {0}", "max": "old > {0} ? old : {0}", "and": "old & {0}",
    "or": "old | {0}", "xor": "old ^ {0}", "exch": "{0}", "cas": "old == {0} ? {1} : old",
}  # fmt: skip
_ROUNDED = {"rzi": "trunc", "rmi": "floor", "rpi": "ceil", "rni": "rint"}
_OPTIX = {
    "get_launch_index_x": ("u32", "lane->index"), "get_launch_dimension_x": ("u32", "lane->count"),
    "hitobject_is_hit": ("u32", "lane->hit.is_hit"), "hitobject_get_instance_id": ("u32", "lane->hit.instance"),
    "hitobject_get_primitive_idx": ("u32", "lane->hit.primitive"),
    "hitobject_get_ray_tmax": ("f32", "lane->hit.distance"),
    "hitobject_get_sbt_data_pointer": ("u64", "lane->hit.data"),
    "hitobject_get_attribute": ("u32", "lane->hit.attributes[{0} & 1]"),
    "call_direct_callable": ("u64", "(uintptr_t)lane->callable(lane, {0})"),
    "call_continuation_callable": ("u64", "(uintptr_t)lane->callable(lane, {0})"),
}  # fmt: skip


class Untranslatable(Exception):
    """PTX that the emulated GPU does not have, or that no card runs."""


def translate(ptx: str) -> str:
    """Return the C of a module of PTX."""
    ptx = re.sub(r"//[^\n]*", "", ptx)
    table = _TABLE.search(ptx)
    names = [name.strip() for name in table[1].split(",")] if table else []
    functions = [match for match in _FUNCTION.finditer(ptx) if ptx[match.end()] == "{"]
    parameters = {match[2]: _names(match[3]) for match in functions}
    heads, bodies = [], []
    for match in functions:
        is_entry = match[1] == "entry"
        heads.append(f"void {match[2]}(Lane *lane{'' if is_entry else _ARGUMENTS})")
        start = "const u8 *params = lane->params;\n" if is_entry else ""
        body = _Body(parameters, n_callables=len(names)).translate(ptx, match.end() + 1)
        bodies.append(f"{heads[-1]} {{\n{start}{body}\n}}")
    callables = f"static Callable *callables[] = {{{', '.join(names)}}};" if names else ""
    return "\n".join(['#include "kernel.h"', *(f"{head};" for head in heads), callables, *bodies])


def _names(parameters: str) -> list[str]:
    """Return the names of declared parameters, such as `.param .align 4 .b8 params[8]`."""
    return [re.split(r"[\s\[]", part.strip().rpartition(" ")[2])[0] for part in parameters.split(",") if part.strip()]


def _bits(kind: str) -> int:
    """Return the size of a type, bits; that of a predicate is the one of a C int."""
    return 32 if kind == "pred" else int(kind[1:])


def _read(operand: str, kind: str) -> str:
    """Return the C of an operand's value as a type of PTX."""
    if operand[0] == "!":
        return f"!{_read(operand[1:], kind)}"
    if operand in _SPECIAL or operand in _PARAMETERS:
        return f"({kind}){_SPECIAL.get(operand, operand)}"
    if operand[0] == "%":
        return f"r_{operand[1:]}.{kind}"
    if not _IMMEDIATE.fullmatch(operand):
        raise Untranslatable(f"operand {operand}")
    if operand[1:2] not in ("x", "X", "f", "F", "d", "D"):
        return f"({kind}){operand}"
    bits = f"0x{operand[2:]}ull"
    return f"float_of({bits})" if kind == "f32" else f"double_of({bits})" if kind == "f64" else f"({kind}){bits}"


def _write(operand: str, kind: str, value: str) -> str:
    """Return the C that sets a register; an integer fills all of it, as a card extends what it loads."""
    target = "r_" + operand.split("|")[0].removeprefix("%")
    return f"{target}.{kind} = {value};" if kind[0] == "f" else f"{target}.u64 = ({kind})({value});"


def _members(operand: str) -> list[str]:
    """Return the operands in `{a, b}` or `(a, b)`; another one is its only member."""
    inner = operand[1:-1].strip() if operand[:1] in ("{", "(") else operand
    return _COMMA.split(inner) if inner else []


class _Body:
    """Translation of the statements of one function.

    Attributes:
        arrays: number of elements of each array that it has declared
    """

    def __init__(self, parameters: dict[str, list[str]], *, n_callables: int) -> None:
        self.arrays = {"callables": n_callables}
        self._parameters = parameters
        self._prototype: list[str] = []
        self._scopes = [0]
        self._n_scopes = 0

    def translate(self, ptx: str, position: int) -> str:
        """Return the C of the statements from ``position`` to the end of their block."""
        lines: list[str] = []
        while self._scopes:
            statement = _STATEMENT.match(ptx, position)
            if statement is None:
                raise Untranslatable(ptx[position : position + 80].strip())
            position = statement.end()
            try:
                lines.append(self._statement(*statement.group("label", "brace", "text")))
            except (Untranslatable, KeyError, IndexError, TypeError) as error:
                raise Untranslatable(f"{statement[0].strip()} ({error})") from error
        text = "\n".join(lines[:-1])
        # No scope reads a register of another one of the same name: all are variables of the function.
        used = sorted(set(_USED.findall(text)))
        return f"Register {', '.join(used)};\n{text}" if used else text

    def _statement(self, label: str | None, brace: str | None, text: str) -> str:
        if label:
            return f"{self._label(label)}:;"
        if brace == "{":
            self._n_scopes += 1
            self._scopes.append(self._n_scopes)
            return "{"
        if brace:
            self._scopes.pop()
            return ";}"
        if text[0] == ".":
            return self._declaration(text)
        condition = ""
        if text[0] == "@":
            predicate, text = text[1:].split(None, 1)
            condition = f"if ({_read(predicate, 'pred')}) "
        operation, _, operands = text.partition(" ")
        name, *suffixes = operation.split(".")
        return f"{condition}{{{self._instruction(name, suffixes, _COMMA.split(operands.strip()))}}}"

    def _label(self, name: str) -> str:
        """Return a label of C for one that its scope, or, with a number in it, the function has once."""
        return f"{name}_" if re.search(r"\d", name) or name == "body" else f"{name}_{self._scopes[-1]}"

    def _declaration(self, text: str) -> str:
        if text.startswith(".callprototype"):
            self._prototype = _names(text.rpartition("(")[2].rstrip(")"))
        array = re.fullmatch(r"\.(?:local|param)\s+\.align\s+\d+\s+\.(\w+)\s+(\w+)\[(\d+)\]", text)
        if array is None:
            return ""  # a register
        self.arrays[array[2]] = int(array[3])
        return f"u64 {array[2]}[{(int(array[3]) * _bits(array[1]) + 63) // 64}];"

    def _instruction(self, name: str, suffixes: list[str], operands: list[str]) -> str:
        if name == "ret":
            return "return;"
        if name == "bra":
            return f"goto {self._label(operands[0])};"
        if name == "call":
            return self._call(operands)
        kind = suffixes[-1]
        if any("f16" in suffix for suffix in suffixes):
            raise Untranslatable("a float of 16 bits")
        if name in ("ld", "ldu", "st", "red", "atom"):
            return self._memory(name, suffixes, operands)
        if name == "tex":
            return self._texture(suffixes, operands)
        if name == "cvt":
            return _write(operands[0], suffixes[-2], _converted(_read(operands[1], kind), *suffixes))
        if name == "setp":
            value = _COMPARISONS[suffixes[0]].format(*(_read(operand, kind) for operand in operands[1:3]))
            other = f" {'&&' if 'and' in suffixes else '||'} {_read(operands[3], 'pred')}" if len(operands) > 3 else ""
            return _write(operands[0], "pred", f"({value}){other}")
        if name == "selp":
            x = [_read(operand, kind) for operand in operands[1:3]]
            return _write(operands[0], kind, f"{_read(operands[3], 'pred')} ? {x[0]} : {x[1]}")
        if name == "mov" and "{" in operands[0] + operands[1]:
            return self._packed(kind, operands)
        if name == "mov" and operands[0].endswith("_out_31") and operands[1] == "0":
            raise Untranslatable("a ray that Dr.Jit left out: a kernel asks two pipelines or tables of OptiX")
        return _write(operands[0], *_computed(name, suffixes, operands[1:]))

    def _packed(self, kind: str, operands: list[str]) -> str:
        """Return the C of a move that takes a register apart or puts one together; or of several moves."""
        parts, wholes = _members(operands[0]), _members(operands[1])
        if len(parts) == len(wholes):
            return "".join(_write(part, kind, _read(whole, kind)) for part, whole in zip(parts, wholes, strict=True))
        bits = _bits(kind) // max(len(parts), len(wholes))
        if len(wholes) == 1:
            whole = _read(wholes[0], kind)
            return "".join(_write(part, f"b{bits}", f"{whole} >> {bits * k}") for k, part in enumerate(parts))
        value = " | ".join(f"(u64){_read(part, f'b{bits}')} << {bits * k}" for k, part in enumerate(wholes))
        return _write(parts[0], kind, value)

    def _address(self, operand: str, kind: str) -> str:
        match = _ADDRESS.fullmatch(operand)
        if match is None:
            raise Untranslatable(f"address {operand}")
        array, base, offset = match[1], match[2], match[3] or 0
        if array:
            return f"&(({kind} *){array})[within(lane, {_read(base, 'u32')}, {self.arrays[array]})]"
        if base in (*self.arrays, "params", "result"):
            return f"(uintptr_t){base} + {offset}"
        return f"{_read(base, 'u64')} + {offset}"

    def _memory(self, name: str, suffixes: list[str], operands: list[str]) -> str:
        """Return the C of a load, a store or an atomic operation; a vector's place is checked as a whole."""
        kind, is_load = suffixes[-1], name in ("ld", "ldu", "atom")
        place, others = operands[is_load], [*operands[:is_load], *operands[is_load + 1 :]]
        registers = _members(others[0])
        address = f"(u64)(uintptr_t)({self._address(place, kind)})"
        if "global" in suffixes and "callables" not in place:
            address = f"checked(lane, {address}, {len(registers) * _bits(kind) // 8})"
        slots = [f"(({kind} *)(uintptr_t)place)[{k}]" for k in range(len(registers))]
        if name in ("red", "atom"):
            values = [_members(operand) for operand in others[is_load:]]
            operation = next(_ATOMIC[suffix] for suffix in suffixes if suffix in _ATOMIC)
            lines = [
                f"{{{kind} old = {slot}; {slot} = {operation.format(*(_read(value[k], kind) for value in values))};"
                + (_write(registers[k], kind, "old") if is_load else "")
                + "}"
                for k, slot in enumerate(slots)
            ]
        elif is_load:
            lines = [_write(register, kind, slot) for register, slot in zip(registers, slots, strict=True)]
        else:
            lines = [f"{slot} = {_read(register, kind)};" for register, slot in zip(registers, slots, strict=True)]
        return f"u64 place = {address}; {' '.join(lines)}"

    def _texture(self, suffixes: list[str], operands: list[str]) -> str:
        match = re.fullmatch(r"(\{.*?\}), \[(\S+), (\{.*\})\]", ", ".join(operands))
        if match is None or suffixes[1:] != ["v4", "f32", "f32"]:
            raise Untranslatable("a texture's level or type")
        registers, texture, place = match.groups()
        n_dimensions = int(suffixes[0][0])
        coordinates = [_read(operand, "f32") for operand in _members(place)[:n_dimensions]]
        texel = "".join(_write(register, "f32", f"texel[{k}]") for k, register in enumerate(_members(registers)))
        return (
            f"f32 texel[4], place[] = {{{', '.join(coordinates)}}};"
            f"lane->sample(lane, {_read(texture, 'u64')}, {n_dimensions}, place, texel); {texel}"
        )

    def _call(self, operands: list[str]) -> str:
        outputs = _members(operands.pop(0)) if operands[0].startswith("(") else []
        callee, arguments = operands[0], _members(operands[1]) if len(operands) > 1 else []
        if callee == "_optix_hitobject_traverse":
            ray = ", ".join(_read(operand, "f32") for operand in arguments[2:10])
            counts = ", ".join(_read(arguments[k], "u32") for k in (11, 13, 14))
            return f"f32 ray[] = {{{ray}}}; lane->trace(lane, {_read(arguments[1], 'u64')}, ray, {counts});"
        if callee in ("_optix_hitobject_make_nop", "_optix_hitobject_reorder"):
            return ""
        if callee.startswith("_optix_"):
            kind, value = _OPTIX[callee.removeprefix("_optix_")]
            return _write(outputs[0], kind, value.format(*(_read(operand, "u32") for operand in arguments)))
        is_pointer = callee[0] == "%"
        names = self._prototype if is_pointer else self._parameters[callee]
        values = dict.fromkeys(("params", *_PARAMETERS), "0")
        for name, operand in zip(names, arguments, strict=True):
            values[name] = f"(u8 *){operand}" if name == "params" else _read(operand, "u64")
        function = f"((Callable *)(uintptr_t){_read(callee, 'u64')})" if is_pointer else callee
        return f"{function}(lane, {f'(u8 *){outputs[0]}' if outputs else '0'}, {', '.join(values.values())});"


def _computed(name: str, suffixes: list[str], operands: list[str]) -> tuple[str, str]:
    """Return type and C of what an instruction without memory computes."""
    kind = suffixes[-1]
    if name in ("activemask", "match", "shfl"):
        kind = "b32"
    if name == "vote":
        kind = "pred"
    bits = _bits(kind)
    x, u = [_read(operand, kind) for operand in operands], []
    if kind[0] == "f":
        value = _FLOAT[name].format(x=x, f="f" * (kind == "f32"))
        if "NaN" in suffixes:
            value = f"{x[0]} == {x[0]} && {x[1]} == {x[1]} ? {value} : {x[0]} + {x[1]}"
        if "approx" in suffixes:
            error = _ABSOLUTE_ERRORS.get(name)
            value = f"displaced({value}, {error.format(value)})" if error else f"approximate({value})"
        return kind, value
    if kind == "pred" and name == "not":
        return kind, f"!{x[0]}"
    if name in ("mul", "mad") and ("wide" in suffixes or ("hi" in suffixes and bits < 64)):
        wide = f"{kind[0]}{2 * bits}"
        product = f"({wide}){x[0]} * ({wide}){x[1]}"
        if "hi" in suffixes:
            return kind, f"({product}) >> {bits}"
        return wide, product + (f" + {_read(operands[2], wide)}" if name == "mad" else "")
    if name == "mul" and "hi" in suffixes and kind == "u64":
        return kind, f"high_half({x[0]}, {x[1]})"
    if "hi" in suffixes:
        raise Untranslatable("half of a signed product")
    u = [_read(operand, "u32") if operand[0] != "{" else "" for operand in operands]
    value = _INTEGER[name].format(x=x, u=u, t=kind, bits=bits)
    return ("u32" if name in ("popc", "clz", "bfind") else kind), value


def _converted(x: str, *suffixes: str) -> str:
    """Return the C of a number of the last type as one of the type before it."""
    target, source = suffixes[-2:]
    rounded = [_ROUNDED[suffix] for suffix in suffixes[:-2] if suffix in _ROUNDED]
    if rounded and source[0] == "f":
        x = f"{rounded[0]}({x})"
    if source[0] == "f" and target[0] != "f":
        return f"to_{'signed' if target[0] == 's' else 'unsigned'}({x}, {_bits(target)})"
    return f"({target})({x})"


if __name__ == "__main__":
    try:
        Path(sys.argv[2]).write_text(translate(Path(sys.argv[1]).read_text(encoding="utf-8")), encoding="utf-8")
    except Untranslatable as error:
        sys.exit(f"emulated GPU: cannot run {error}: {Path(sys.argv[1]).absolute()}")
