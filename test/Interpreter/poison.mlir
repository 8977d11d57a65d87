// RUN: tai-run %s --interpret --no-cache --print-field=@y | FileCheck %s
// RUN: tai-run %s --no-cache --print-field=@y | FileCheck %s

// The component at -1 is poison. A select may leave it aside.
// CHECK: @y : 2xf64 = [1.5, 1.5]
tai.tree @t : !tai.root<dense<[i: 2], {y: f64}>>
tai.field @y = @t["y"] : f64, rank 1
tai.kernel @k(%a: f64) {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) in @y {
    %v = vector.from_elements %a, %a : vector<2xf64>
    %never = arith.cmpi slt, %i, %c0 : index
    %p = vector.extract %v[-1] : f64 from vector<2xf64>
    %q = arith.addf %p, %a : f64
    %r = arith.select %never, %q, %a : f64
    tai.store %r, @y[%i] : f64
  }
  tai.return
}
func.func @main() {
  %a = arith.constant 1.5 : f64
  tai.launch @k(%a) : (f64) -> ()
  return
}
