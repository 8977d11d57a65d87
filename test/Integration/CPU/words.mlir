// RUN: tai-run %s --no-cache --print-field=@r | FileCheck %s --check-prefix=DEFAULT
// RUN: tai-run %s --no-cache --precision=f64 --print-field=@r | FileCheck %s --check-prefix=F64
// RUN: tai-run %s --no-cache --sums=compensated --print-field=@r | FileCheck %s --check-prefix=COMPENSATED
// RUN: tai-run %s --no-cache --math=strict --print-field=@r | FileCheck %s --check-prefix=STRICT
// RUN: tai-run %s --no-cache --ftz --print-field=@r | FileCheck %s --check-prefix=FTZ
// RUN: tai-run %s --no-cache --math=accurate --sums=deterministic --print-ir=tai 2>&1 | FileCheck %s --check-prefix=WORDS
// RUN: tai-run %s --no-cache --adjoints=f64 --print-field=@r | FileCheck %s --check-prefix=DEFAULT
// RUN: not tai-run %s --math=strict --fast-math 2>&1 | FileCheck %s --check-prefix=BOTH
// RUN: not tai-run %s --strict --math=fast 2>&1 | FileCheck %s --check-prefix=SHORT
// RUN: not tai-run %s --math=accurate --fast-math 2>&1 | FileCheck %s --check-prefix=ACCURATE
// RUN: not tai-run %s --sums=compensated --math=fast 2>&1 | FileCheck %s --check-prefix=SUMS
// RUN: not tai-run %s --sums=pairwise 2>&1 | FileCheck %s --check-prefix=UNKNOWN
// RUN: not tai-run %s --precision=f16 2>&1 | FileCheck %s --check-prefix=STORAGE
// RUN: not tai-run %s --interpret --ftz 2>&1 | FileCheck %s --check-prefix=NOCODE
// RUN: not tai-run %s --interpret --math=accurate 2>&1 | FileCheck %s --check-prefix=NOFUNCTIONS

// The words of a context stand on each of its kernels that does not say
// otherwise itself.

// Elements: 1e8 + 1 - 1e8 in one iteration and over iterations, a product
// rounded before it is subtracted from, and a denormal number.
// DEFAULT: @r : 4xf32 = [0, 0, {{.+}}, 1e-40]
// F64: @r : 4xf32 = [1, 0, {{.+}}, 1e-40]
// COMPENSATED: @r : 4xf32 = [0, 1, {{.+}}, 1e-40]
// STRICT: @r : 4xf32 = [0, 0, 0, 1e-40]
// FTZ: @r : 4xf32 = [0, 0, {{.+}}, 0]
// WORDS-DAG: tai.kernel @terms() attributes {{.*}}math = "accurate", sums = "deterministic"
// WORDS-DAG: tai.kernel @own() attributes {{.*}}math = "default", sums = "deterministic"
// BOTH: error: options 'math="strict"' and 'fast_math' contradict one another: the first rounds every operation by itself, the second reorders them; choose one
// SHORT: error: options 'strict' and 'math="fast"' contradict one another
// ACCURATE: error: options 'math="accurate"' and 'fast_math' contradict one another: the first wants every function right to one unit in the last place, the second approximates them; choose one
// SUMS: error: options 'sums="compensated"' and 'math="fast"' contradict one another: the first keeps what a sum rounds away, the second may cancel it by reordering; choose one
// UNKNOWN: error: option 'sums' expects default, compensated or deterministic, but got 'pairwise'
// STORAGE: error: option 'precision' expects default, f64 or f32 (numbers of 16 bits are types of fields), but got 'f16'
// NOCODE: words.mlir:{{[0-9]+}}:{{[0-9]+}}: error: kernel 'fill': ftz=True cannot be had where no code is made
// NOFUNCTIONS: error: kernel 'fill': math="accurate" cannot be had where no code is made

tai.tree @t : !tai.root<dense<[i: 3], {x: f32}>, dense<[i: 4], {r: f32}>, {a: f32, b: f32, d: f32, gd: f64}>
tai.field @x = @t["x"] : f32, rank 1
tai.field @r = @t["r"] : f32, rank 1
tai.field @a = @t["a"] : f32, rank 0
tai.field @b = @t["b"] : f32, rank 0
tai.field @gd = @t["gd"] : f64, rank 0
tai.field @d = @t["d"] : f32, rank 0, adjoint @gd

tai.kernel @fill() {
  %0 = arith.constant 0 : index
  %1 = arith.constant 1 : index
  %2 = arith.constant 2 : index
  %big = arith.constant 1.0e8 : f32
  %one = arith.constant 1.0 : f32
  %minus = arith.constant -1.0e8 : f32
  tai.store %big, @x[%0] : f32
  tai.store %one, @x[%1] : f32
  tai.store %minus, @x[%2] : f32
  // 1 + 2^-13 and 1 - 2^-13
  %a = arith.constant 1.0001220703125 : f32
  %b = arith.constant 0.9998779296875 : f32
  tai.store %a, @a[] : f32
  tai.store %b, @b[] : f32
  %d = arith.constant 1.0e-30 : f32
  tai.store %d, @d[] : f32
  tai.return
}

tai.kernel @terms() {
  %0 = arith.constant 0 : index
  %1 = arith.constant 1 : index
  %2 = arith.constant 2 : index
  %3 = arith.constant 3 : index
  %x0 = tai.load @x[%0] : f32
  %x1 = tai.load @x[%1] : f32
  %x2 = tai.load @x[%2] : f32
  %s = arith.addf %x0, %x1 : f32
  %t = arith.addf %s, %x2 : f32
  tai.store %t, @r[%0] : f32
  tai.parallel_for (%i) in @x {
    %v = tai.load @x[%i] : f32
    %old = tai.atomic add %v, @r[%1] : f32
  }
  %a = tai.load @a[] : f32
  %b = tai.load @b[] : f32
  %one = arith.constant 1.0 : f32
  %p = arith.mulf %a, %b : f32
  %q = arith.subf %p, %one : f32
  tai.store %q, @r[%2] : f32
  %d = tai.load @d[] : f32
  %tiny = arith.constant 1.0e-10 : f32
  %e = arith.mulf %d, %tiny : f32
  tai.store %e, @r[%3] : f32
  tai.return
}

tai.kernel @own() attributes {tai.modes = {math = "default"}} {
  tai.parallel_for (%i) in @x {
    %v = tai.load @x[%i] : f32
    tai.store %v, @x[%i] : f32
  }
  tai.return
}

func.func @main() {
  tai.launch @fill() : () -> ()
  tai.launch @terms() : () -> ()
  tai.launch @own() : () -> ()
  return
}
