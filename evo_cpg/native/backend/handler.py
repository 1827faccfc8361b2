"""Write the entry into native code, an XLA FFI handler, as LLVM IR.

XLA calls the handler with a *call frame*. The public header ``xla/ffi/api/c_api.h`` in
`jax.ffi.include_dir()` defines its layout. On 64-bit machines:

| structure | fields and their offsets in bytes |
|---|---|
| call frame | extension 8, stage 32, arguments 40, results 80 |
| arguments, results (within the frame) | pointers +32 |
| buffer | data 24, dimensions 40 |
| extension | type 8, metadata 24 (only in a request for metadata) |
| metadata | version 24 (major, minor), traits 32 |

A call needs no checks of types and shapes. `evo_cpg.native.native.evaluate` makes all calls, with
the arrays of the compiled program. A user does not call a handler directly: its name is a hash of
its code.

A changed layout in a new XLA does not harm the user's process. XLA refuses to register a handler
for another version of the interface. The self-test of `evo_cpg.native.engine` then tests the
layout in a separate process before the first use of native code.
"""

# Version of the XLA FFI interface.
_MAJOR, _MINOR = 0, 1

# XLA's number for the extension that requests metadata, and for the stage that computes.
_METADATA, _EXECUTE = 1, 3


def handler(name: str, arguments: int, results: int) -> str:
    """Return LLVM IR of a handler ``@name`` that runs ``@program``.

    Args:
        name: name of the function.
        arguments: number of arrays that the program reads.
        results: number of arrays that it writes, at least one. Scratch memory comes after them.
    """
    buffers = [("arguments", k) for k in range(arguments)]
    buffers += [("results", k) for k in range(results + 1)]
    pointers = "\n".join(
        line
        for which, k in buffers
        for line in (
            _load(f"%{which}.{k}", "ptr", f"%{which}", 8 * k),
            _load(f"%{which}.{k}.data", "ptr", f"%{which}.{k}", 24),
        )
    )
    given = ", ".join(f"ptr %{which}.{k}.data" for which, k in buffers)
    return f"""
define ptr @{name}(ptr %frame) #0 {{
entry:
{_load("%extension", "ptr", "%frame", 8)}
  %plain = icmp eq ptr %extension, null
  br i1 %plain, label %staging, label %extended
extended:
{_load("%type", "i32", "%extension", 8)}
  %asks = icmp eq i32 %type, {_METADATA}
  br i1 %asks, label %answer, label %staging
answer:
{_load("%metadata", "ptr", "%extension", 24)}
  %version = getelementptr i8, ptr %metadata, i64 24
  store [3 x i32] [i32 {_MAJOR}, i32 {_MINOR}, i32 0], ptr %version
  br label %done
staging:
{_load("%stage", "i32", "%frame", 32)}
  %runs = icmp eq i32 %stage, {_EXECUTE}
  br i1 %runs, label %run, label %done
run:
{_load("%arguments", "ptr", "%frame", 72)}
{_load("%results", "ptr", "%frame", 112)}
{pointers}
{_load("%dimensions", "ptr", "%results.0", 40)}
{_load("%n", "i64", "%dimensions", 8)}
  call void @program({given}, i64 %n)
  br label %done
done:
  ret ptr null
}}
"""


def _load(name: str, kind: str, base: str, offset: int) -> str:
    """Return lines of LLVM IR that load a field of a structure."""
    return (
        f"  {name}.at = getelementptr i8, ptr {base}, i64 {offset}\n"
        f"  {name} = load {kind}, ptr {name}.at"
    )
