// RUN: not tai-run %s --no-cache 2>&1 | FileCheck %s

// CHECK: error: index [-9223372036854775808] is out of range for field '@x' of shape [8]

tai.tree @t : !tai.root<dense<[i: 8], {x: f32}>>
tai.field @x = @t["x"] : f32, rank 1

tai.kernel @range(%from: index, %to: index) {
  %one = arith.constant 1.0 : f32
  tai.parallel_for (%i) = (%from) to (%to) {
    tai.store %one, @x[%i] : f32
  }
  tai.return
}

func.func @main() {
  %least = arith.constant -9223372036854775808 : index
  %most = arith.constant 9223372036854775807 : index
  tai.launch @range(%least, %most) : (index, index) -> ()
  return
}
