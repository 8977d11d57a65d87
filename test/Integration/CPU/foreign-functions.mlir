// RUN: tai-run %s --no-cache --print-field=@x | FileCheck %s
// RUN: tai-run %s --no-cache --opt-level=0 --print-field=@x | FileCheck %s

// A program runs beside functions that have nothing to do with it.
// CHECK: @x : f64 = 3{{$}}
tai.tree @t : !tai.root<{x: f64}>
tai.field @x = @t["x"] : f64, rank 0

func.func private @external(memref<?xf32>)
func.func @blocks(%c: i1, %a: f64) -> f64 {
  cf.cond_br %c, ^one, ^two
^one:
  return %a : f64
^two:
  %0 = arith.negf %a : f64
  return %0 : f64
}
func.func @down(%n: i64) -> i64 {
  %0 = func.call @down(%n) : (i64) -> i64
  return %0 : i64
}
llvm.func @plain(%a: f64) -> f64 {
  %0 = llvm.fadd %a, %a : f64
  llvm.return %0 : f64
}
tai.kernel @set() {
  %0 = arith.constant 3.0 : f64
  tai.store %0, @x[] : f64
  tai.return
}
func.func @main() {
  tai.launch @set() : () -> ()
  return
}
