// RUN: not tai-run %s --debug 2>&1 | FileCheck %s

// In debug mode an index outside its field is an error at its place.

tai.tree @t : !tai.root<dense<[i: 4], {x: f64}>>
tai.field @x = @t["x"] : f64, rank 1

tai.kernel @shift(%n: i32) {
  %by = arith.index_cast %n : i32 to index
  tai.parallel_for (%i) in @x {
    %j = arith.addi %i, %by : index
    // CHECK: debug-index.mlir:[[@LINE+1]]:10: error: index [4] is out of range for field '@x'
    %v = tai.load @x[%j] : f64
    tai.store %v, @x[%i] : f64
  }
  tai.return
}

func.func @main() {
  %zero = arith.constant 0 : i32
  %one = arith.constant 1 : i32
  tai.launch @shift(%zero) : (i32) -> ()
  tai.launch @shift(%one) : (i32) -> ()
  return
}
