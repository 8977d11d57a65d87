// RUN: tai-opt %s --tai-lower-layout --convert-tai-to-scf | FileCheck %s
// RUN: tai-opt %s --tai-lower-layout --convert-tai-to-gpu | FileCheck %s --check-prefix=GPU
// RUN: tai-opt %s --tai-to-llvm | tai-translate --mlir-to-llvmir | FileCheck %s --check-prefix=IR

// One branch at the top, and a block that reports the failure: code that runs
// comes after it. A kernel that cannot fail otherwise returns a constant.
// CHECK-LABEL: llvm.func @step(
//       CHECK:   %[[OK:.+]] = arith.andi
//       CHECK:   llvm.cond_br %[[OK]] weights([1048576, 1]), ^bb[[BODY:.]], ^bb[[REFUSE:.]]
//       CHECK: ^bb[[BODY]]:
//   CHECK-NOT:   tai_rt_failed
//       CHECK:   llvm.return
//       CHECK: ^bb[[REFUSE]]:
//       CHECK:   scf.if
//       CHECK:     llvm.call @tai_rt_fail
//       CHECK:   scf.if
//       CHECK:     llvm.call @tai_rt_fail
//       CHECK:   %[[ONE:.+]] = arith.constant 1 : i32
//       CHECK:   llvm.return %[[ONE]]
//   CHECK-NOT:   tai.precondition

// The host refuses: no function of the device has any of that.
//   GPU-LABEL: gpu.module @kernels
//     GPU-NOT:   tai_rt_fail
//     GPU-NOT:   tai_dev_fail
//         GPU: llvm.func @step(
//         GPU:   llvm.cond_br
//         GPU:   gpu.launch_func
//         GPU:   llvm.call @tai_rt_fail

// IR-LABEL: define i32 @step(ptr
//       IR:   br i1 %{{.+}}, label %{{.+}}, label %{{.+}}, !prof

tai.tree @t : !tai.root<dense<[i: 8], {x: f32}>>
tai.field @x = @t["x"] : f32, rank 1

tai.kernel @step(%n: i32) {
  %c0 = arith.constant 0 : i32
  %c8 = arith.constant 8 : i32
  %zero = arith.constant 0 : index
  %one = arith.constant 1.0 : f32
  %a = arith.cmpi sge, %n, %c0 : i32
  tai.precondition %a, "{} is negative"(%n) : i32
  %b = arith.cmpi slt, %n, %c8 : i32
  tai.precondition %b, "{} is large"(%n) : i32
  %to = arith.index_cast %n : i32 to index
  tai.parallel_for (%i) = (%zero) to (%to) {
    tai.store %one, @x[%i] : f32
  }
  tai.return
}
