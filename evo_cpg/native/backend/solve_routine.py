"""Write a function in LLVM IR that solves symmetric linear equations.

The function has loops over rows and columns instead of straight-line code. It eliminates in the
order of `evo_cpg.native.ldl`. It skips elements that are zero for all individuals of a processor
vector, such as the coupling of limbs that do not touch.
"""


def routine(name: str, t: str, row: int, size: int, fma: bool) -> str:
    """Return LLVM IR of a function that solves equations in memory.

    The equations are ``H x = b``. The lower triangle of H is stored row by row, and overwritten.
    The solution replaces b.

    Args:
        name: name of the function.
        t: LLVM's type of a number.
        row: bytes from one number to the next.
        size: bytes of one individual's number.
        fma: whether the processor multiplies and adds in one instruction.
    """
    lanes, _, item = t[1:-1].partition(" x ") if t.startswith("<") else ("", "", t)
    suffix = ("v" + lanes if lanes else "") + {"float": "f32", "double": "f64"}[item]
    zero, one = (f"splat ({item} {x})" if lanes else x for x in ("0.0", "1.0"))
    flag = f"<{lanes} x i1>" if lanes else "i1"

    def load(out: str, pointer: str) -> str:
        return f"{out} = load {t}, ptr {pointer}, align {size}"

    def less(out: str, a: str, x: str, y: str) -> str:
        """Subtract a product."""
        if fma:
            return (
                f"{out}.n = fneg {t} {x}\n"
                f"{out} = call {t} @llvm.fma.{suffix}({t} {out}.n, {t} {y}, {t} {a})"
            )
        return f"{out}.m = fmul {t} {x}, {y}\n{out} = fsub {t} {a}, {out}.m"

    def at(out: str, base: str, index: str) -> str:
        return (
            f"{out}.s = mul i64 {index}, {row}\n{out} = getelementptr i8, ptr {base}, i64 {out}.s"
        )

    any_of = f"%some = call i1 @llvm.vector.reduce.or.v{lanes}i1({flag} %nonzero)"
    if not lanes:
        any_of = "%some = or i1 %nonzero, false"
    return f"""
define internal void @{name}(ptr %H, ptr %b, i64 %count) noinline #0 {{
entry:
  %last = sub i64 %count, 1
  br label %pivot
pivot:
  %k = phi i64 [ %last, %entry ], [ %k.less, %pivot.done ]
  %k.more = add i64 %k, 1
  %k.twice = mul i64 %k, %k.more
  %k.row = lshr i64 %k.twice, 1
  {at("%row.k", "%H", "%k.row")}
  {at("%diagonal", "%row.k", "%k")}
  {load("%d", "%diagonal")}
  %inverse = fdiv {t} {one}, %d
  store {t} %inverse, ptr %diagonal, align {size}
  {at("%bk", "%b", "%k")}
  {load("%z", "%bk")}
  br label %column
column:
  %i = phi i64 [ %k, %pivot ], [ %i.less, %column.done ]
  %more = icmp ne i64 %i, 0
  br i1 %more, label %look, label %pivot.done
look:
  %i.less = sub i64 %i, 1
  {at("%rk", "%row.k", "%i.less")}
  {load("%r", "%rk")}
  %nonzero = fcmp une {t} %r, {zero}
  {any_of}
  br i1 %some, label %update, label %column.done
update:
  %scaled = fmul {t} %r, %inverse
  %i.twice = mul i64 %i, %i.less
  %i.row = lshr i64 %i.twice, 1
  {at("%row.i", "%H", "%i.row")}
  br label %element
element:
  %j = phi i64 [ 0, %update ], [ %j.next, %element ]
  {at("%pk", "%row.k", "%j")}
  {at("%pi", "%row.i", "%j")}
  {load("%hk", "%pk")}
  {load("%hi", "%pi")}
  {less("%new", "%hi", "%scaled", "%hk")}
  store {t} %new, ptr %pi, align {size}
  %j.next = add i64 %j, 1
  %j.more = icmp ult i64 %j.next, %i
  br i1 %j.more, label %element, label %element.done
element.done:
  store {t} %scaled, ptr %rk, align {size}
  {at("%bi", "%b", "%i.less")}
  {load("%b.old", "%bi")}
  {less("%b.new", "%b.old", "%scaled", "%z")}
  store {t} %b.new, ptr %bi, align {size}
  br label %column.done
column.done:
  br label %column
pivot.done:
  %k.less = sub i64 %k, 1
  %k.again = icmp ne i64 %k, 0
  br i1 %k.again, label %pivot, label %forward
forward:
  %m = phi i64 [ 0, %pivot.done ], [ %m.next, %forward.done ]
  %m.next = add i64 %m, 1
  %m.twice = mul i64 %m, %m.next
  %m.row = lshr i64 %m.twice, 1
  {at("%row.m", "%H", "%m.row")}
  {at("%dm", "%row.m", "%m")}
  {load("%inverse.m", "%dm")}
  {at("%bm", "%b", "%m")}
  {load("%half", "%bm")}
  %begin = fmul {t} %half, %inverse.m
  br label %known
known:
  %q = phi i64 [ 0, %forward ], [ %q.next, %subtract ]
  %sum = phi {t} [ %begin, %forward ], [ %sum.next, %subtract ]
  %q.more = icmp ult i64 %q, %m
  br i1 %q.more, label %subtract, label %forward.done
subtract:
  {at("%pq", "%row.m", "%q")}
  {load("%l", "%pq")}
  {at("%bq", "%b", "%q")}
  {load("%x", "%bq")}
  {less("%sum.next", "%sum", "%l", "%x")}
  %q.next = add i64 %q, 1
  br label %known
forward.done:
  store {t} %sum, ptr %bm, align {size}
  %m.more = icmp ult i64 %m.next, %count
  br i1 %m.more, label %forward, label %done
done:
  ret void
}}"""
