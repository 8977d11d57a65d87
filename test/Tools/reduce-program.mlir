// RUN: tai-reduce %s -tai-reduction='test=%S/Inputs/has-sparse-store.sh' -o %t
// RUN: FileCheck %s --input-file %t
// RUN: grep -c . %t | FileCheck %s --check-prefix=LINES
// RUN: FileCheck %s --check-prefix=COUNT --input-file %t
// RUN: not tai-reduce %s -tai-reduction='test=/bin/true' 2>&1 | FileCheck %s --check-prefix=NONE

// One kernel with one store is left, of a tree with one level.
//     CHECK: tai.tree @t : !tai.root<pointer<[i: {{[12]}}], {{.*}}>>
// CHECK-NOT: pointer
// CHECK-NOT: tai.launch
// CHECK-NOT: parallel_for
// CHECK-NOT: scf.for
//     CHECK: tai.store
// CHECK-NOT: tai.store
//   COUNT-COUNT-1: tai.kernel
//       COUNT-NOT: tai.kernel

// Of 36 lines 9 are left.
// LINES: {{^9$}}

// NONE: error: the test does not find what it looks for in the input

tai.tree @t : !tai.root<pointer<[i: 8], pointer<[i: 4], bitmasked<[i: 16], {x: f32, "x.grad": f32, y: f32}>>>, {loss: f32, "loss.grad": f32}>
tai.field @x = @t["x"] : f32, rank 1, adjoint @x.grad
tai.field @x.grad = @t["x.grad"] : f32, rank 1
tai.field @y = @t["y"] : f32, rank 1
tai.field @loss = @t["loss"] : f32, rank 0, adjoint @loss.grad
tai.field @loss.grad = @t["loss.grad"] : f32, rank 0

tai.kernel @advance(%steps: index, %a: f32) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  scf.for %t = %c0 to %steps step %c1 {
    tai.parallel_for (%i) in @x {
      %0 = tai.load @x[%i] : f32
      %1 = arith.mulf %0, %a : f32
      tai.store %1, @y[%i] : f32
      %2 = arith.addf %1, %0 : f32
      tai.store %2, @x[%i] : f32
    }
  }
  tai.return
}

tai.kernel @measure() {
  tai.parallel_for (%i) in @y {
    %0 = tai.load @y[%i] : f32
    %1 = tai.atomic add %0, @loss[] : f32
  }
  tai.return
}

func.func @main() {
  %c4 = arith.constant 4 : index
  %a = arith.constant 0.5 : f32
  tai.tape loss(@loss) {
    tai.launch @advance(%c4, %a) : (index, f32) -> ()
    tai.launch @measure() : () -> ()
  }
  return
}
