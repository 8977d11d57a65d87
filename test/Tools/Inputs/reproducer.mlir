// lowering of 'bad' failed inside the compiler
// tai-opt --run-reproducer <this file>
tai.kernel @fine(%a: f32) -> f32 {
  %0 = arith.addf %a, %a : f32
  tai.return %0 : f32
}

tai.kernel @bad(%a: index) {
  %0 = arith.addi %a, %a : index
  %1 = shape.mul %a, %0 : index, index -> index
  %2 = arith.addi %1, %0 : index
  tai.return
}

{-#
  external_resources: {
    mlir_reproducer: {
      pipeline: "builtin.module(tai-check-lowerable)",
      disable_threading: true,
      verify_each: true
    }
  }
#-}
