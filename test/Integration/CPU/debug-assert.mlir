// RUN: not tai-run %s --debug 2>&1 | FileCheck %s
// RUN: tai-run %s

// An assertion is checked in debug mode only, and names its values.

tai.tree @t : !tai.root<dense<[i: 4], {x: f64}>>
tai.field @x = @t["x"] : f64, rank 1

tai.kernel @positive() {
  %zero = arith.constant 0.0 : f64
  %c2 = arith.constant 2 : index
  %v = tai.load @x[%c2] : f64
  %ok = arith.cmpf ogt, %v, %zero : f64
  // CHECK: debug-assert.mlir:[[@LINE+1]]:3: error: x[2] is 0{{.*}}, which is not positive
  tai.assert %ok, "x[{}] is {}, which is not positive"(%c2, %v) : index, f64
  tai.return
}

func.func @main() {
  tai.launch @positive() : () -> ()
  return
}
