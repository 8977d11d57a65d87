// Checks were ops of 'tai'. The parser reads their former names as the present
// ones; ops of the generic form or bytecode are replaced by canonicalisation
// and where host functions are lowered.
//
// RUN: split-file %s %t
// RUN: tai-opt %t/custom.mlir | FileCheck %s --check-prefix=NEW
// RUN: tai-opt %t/custom.mlir | tai-opt | FileCheck %s --check-prefix=NEW
// RUN: tai-opt %t/generic.mlir | FileCheck %s --check-prefix=OLD
// RUN: tai-opt %t/generic.mlir | tai-opt | FileCheck %s --check-prefix=NEW
// RUN: tai-opt %t/generic.mlir --canonicalize | FileCheck %s --check-prefix=NEW
// RUN: tai-opt %t/generic.mlir --emit-bytecode | tai-opt --canonicalize | FileCheck %s --check-prefix=NEW
// RUN: tai-opt %t/generic.mlir --mlir-print-op-generic | tai-opt --canonicalize | FileCheck %s --check-prefix=NEW
//
// All forms make the same code, and the same gradients before that.
// RUN: sed -e 's/tai.check_/tai_check./' %t/custom.mlir > %t/present.mlir
// RUN: tai-opt %t/custom.mlir --tai-autodiff --tai-to-llvm | sed -e 's|"[^"]*mlir:[0-9:]*|"place|' > %t/custom.out
// RUN: tai-opt %t/generic.mlir --tai-autodiff --tai-to-llvm | sed -e 's|"[^"]*mlir:[0-9:]*|"place|' > %t/generic.out
// RUN: tai-opt %t/present.mlir --tai-autodiff --tai-to-llvm | sed -e 's|"[^"]*mlir:[0-9:]*|"place|' > %t/present.out
// RUN: diff %t/custom.out %t/generic.out
// RUN: diff %t/custom.out %t/present.out
// RUN: tai-opt %t/generic.mlir --tai-scalarize --tai-lower-struct-for --tai-relax-atomics --tai-lower-layout --convert-tai-to-scf | FileCheck %s --check-prefix=CALLS
//
// And they run, compiled or not.
// RUN: tai-run %t/custom.mlir --no-cache
// RUN: tai-run %t/generic.mlir --no-cache
// RUN: tai-run %t/generic.mlir --interpret
// RUN: sed -e 's/4.000000e-01/1.0/' %t/generic.mlir > %t/wrong.mlir
// RUN: not tai-run %t/wrong.mlir --no-cache 2>&1 | FileCheck %s --check-prefix=WRONG
//
// Kernels that no tape launches are not differentiated: the former op is a tape.
// RUN: tai-opt %t/generic.mlir --tai-autodiff | FileCheck %s --check-prefix=GRAD

// NEW-LABEL: func.func @main
//       NEW:   tai_check.gradient loss(@loss) wrt [@x] tolerance {{.+}} {
//  NEW-NEXT:     tai.launch @square
//  NEW-NEXT:   } {test.note}
//       NEW:   tai_check.close %{{.+}}, %{{.+}} tolerance {{.+}} {test.note} : f64

// OLD-LABEL: func.func @main
//       OLD:   tai.check_gradient loss(@loss) wrt [@x] tolerance 9.9999999999999995E-8 {
//  OLD-NEXT:     tai.launch @square
//  OLD-NEXT:   } {test.note}
//       OLD:   tai.check_close %{{.+}}, %{{.+}} tolerance 9.9999999999999995E-8 {test.note} : f64

// CALLS: llvm.call @tai_rt_host_check_gradient
// WRONG: error: check failed: got 0.4{{.*}}, expected 1

//     GRAD: tai.kernel @square_grad
// GRAD-NOT: tai.kernel @other_grad

//--- custom.mlir
tai.tree @t : !tai.root<{x: f64, gx: f64, loss: f64, gloss: f64}>
tai.field @gx = @t["gx"] : f64, rank 0
tai.field @gloss = @t["gloss"] : f64, rank 0
tai.field @x = @t["x"] : f64, rank 0, adjoint @gx
tai.field @loss = @t["loss"] : f64, rank 0, adjoint @gloss
tai.kernel @square() {
  %0 = tai.load @x[] : f64
  %1 = arith.mulf %0, %0 : f64
  tai.atomic add %1, @loss[] : f64
  tai.return
}
tai.kernel @other() {
  %0 = tai.load @x[] : f64
  tai.store %0, @loss[] : f64
  tai.return
}
func.func @main() {
  %0 = arith.constant 2.000000e-01 : f64
  %1 = arith.constant 4.000000e-01 : f64
  tai.store %0, @x[] : f64
  tai.check_gradient loss(@loss) wrt [@x] tolerance 1.0e-7 {
    tai.launch @square() : () -> ()
  } {test.note}
  %2 = tai.load @gx[] : f64
  tai.check_close %2, %1 tolerance 1.0e-7 {test.note} : f64
  return
}

//--- generic.mlir
tai.tree @t : !tai.root<{x: f64, gx: f64, loss: f64, gloss: f64}>
tai.field @gx = @t["gx"] : f64, rank 0
tai.field @gloss = @t["gloss"] : f64, rank 0
tai.field @x = @t["x"] : f64, rank 0, adjoint @gx
tai.field @loss = @t["loss"] : f64, rank 0, adjoint @gloss
tai.kernel @square() {
  %0 = tai.load @x[] : f64
  %1 = arith.mulf %0, %0 : f64
  tai.atomic add %1, @loss[] : f64
  tai.return
}
tai.kernel @other() {
  %0 = tai.load @x[] : f64
  tai.store %0, @loss[] : f64
  tai.return
}
func.func @main() {
  %0 = arith.constant 2.000000e-01 : f64
  %1 = arith.constant 4.000000e-01 : f64
  tai.store %0, @x[] : f64
  "tai.check_gradient"() <{loss = @loss, tolerance = 1.0e-7 : f64, wrt = [@x]}> ({
    "tai.launch"() <{kernel = @square}> : () -> ()
    "tai.yield"() : () -> ()
  }) {test.note} : () -> ()
  %2 = tai.load @gx[] : f64
  "tai.check_close"(%2, %1) <{tolerance = 1.0e-7 : f64}> {test.note} : (f64, f64) -> ()
  return
}
