// CHECK-LABEL: llvm.func @double_to_x(
//       CHECK:   llvm.fadd
tai.tree @scene : !tai.root<dense<[i: 16], {x: f32}>>
tai.field @x = @scene["x"] : f32, rank 1
tai.kernel @double() {
  tai.parallel_for (%i) in @x {
    %value = tai.load @x[%i] : f32
    %twice = arith.addf %value, %value : f32
    tai.store %twice, @x[%i] : f32
  }
  tai.return
}
