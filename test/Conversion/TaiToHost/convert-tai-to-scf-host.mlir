// RUN: tai-opt %s --convert-tai-to-scf | FileCheck %s

tai.tree @t : !tai.root<{loss: f64, grad: f64, x: f64, gx: f64}>
tai.field @grad = @t["grad"] : f64, rank 0
tai.field @gx = @t["gx"] : f64, rank 0
tai.field @loss = @t["loss"] : f64, rank 0, adjoint @grad
tai.field @x = @t["x"] : f64, rank 0, adjoint @gx

// CHECK: llvm.mlir.global internal constant @{{.+}}("{{.*}}convert-tai-to-scf-host.mlir:{{[0-9]+}}:3\00")
// CHECK: llvm.mlir.global internal constant @[[$STEP:.+]]("step\00")

tai.kernel @step(%n: i32, %x: f64) -> f64 {
  tai.return %x : f64
}

// A launch passes slots and reads the result from one. A loop of the host
// stays in scf; its launches take their slots from the entry.
// CHECK-LABEL: llvm.func @main(
//  CHECK-SAME:     %[[FRAME:.+]]: !llvm.ptr) -> i32
//       CHECK:   %[[RESULT:.+]] = llvm.alloca %{{.+}} x !llvm.array<1 x i64>
//       CHECK:   %[[ARGS:.+]] = llvm.alloca %{{.+}} x !llvm.array<2 x i64>
//       CHECK:   llvm.call @tai_rt_host_tape_begin(%[[FRAME]], %{{.+}})
//       CHECK:   scf.for
//       CHECK:     llvm.store %{{.+}}, %[[ARGS]] : i32, !llvm.ptr
//       CHECK:     %[[SLOT1:.+]] = llvm.getelementptr inbounds %[[ARGS]][1]
//       CHECK:     llvm.store %{{.+}}, %[[SLOT1]] : f64, !llvm.ptr
//       CHECK:     %[[NAME:.+]] = llvm.mlir.addressof @[[$STEP]]
//       CHECK:     llvm.call @tai_rt_host_launch(%[[FRAME]], %[[NAME]], %[[ARGS]], %{{.+}}, %[[RESULT]], %{{.+}})
//       CHECK:     %[[R:.+]] = llvm.load %[[RESULT]] : !llvm.ptr -> f64
//       CHECK:     arith.subf %[[R]]
//       CHECK:     arith.cmpf ugt
//       CHECK:     scf.if
//       CHECK:       llvm.call @tai_rt_fail
//       CHECK:   llvm.call @tai_rt_host_tape_end(%[[FRAME]])
//       CHECK:   %[[STATUS:.+]] = llvm.call @tai_rt_failed(%[[FRAME]])
//       CHECK:   llvm.return %[[STATUS]]
func.func @main() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c9 = arith.constant 9 : index
  %one = arith.constant 1.0 : f64
  tai.tape loss(@loss) {
    scf.for %i = %c0 to %c9 step %c1 {
      %n = arith.index_cast %i : index to i32
      %0 = tai.launch @step(%n, %one) : (i32, f64) -> f64
      tai_check.close %0, %one tolerance 1.0e-6 : f64
    }
  }
  return
}

// The launches to differentiate become a function, with a closure.
// CHECK-LABEL: llvm.func @check(
//       CHECK:   %[[NAMES:.+]] = llvm.alloca %{{.+}} x !llvm.array<2 x i64>
//       CHECK:   llvm.mlir.addressof @check.check0
//       CHECK:   llvm.call @tai_rt_host_check_gradient
// CHECK-LABEL: llvm.func internal @check.check0(
//  CHECK-SAME:     %[[FRAME:.+]]: !llvm.ptr, %{{.+}}: !llvm.ptr) -> i32
//       CHECK:   llvm.call @tai_rt_host_launch(%[[FRAME]],
//       CHECK:   llvm.call @tai_rt_failed(%[[FRAME]])
func.func @check(%x: f64) {
  %n = arith.constant 3 : i32
  tai_check.gradient loss(@loss) wrt [@x, @loss] tolerance 1.0e-7 {
    %0 = tai.launch @step(%n, %x) : (i32, f64) -> f64
  }
  return
}

// A private function was a helper.
// CHECK-NOT: @helper
func.func private @helper(%x: f64) -> f64 {
  return %x : f64
}
