// Rows of 8 cells of which 6 are used, in blocks that lie column by column and
// are active one by one.
tai.tree @t : !tai.root<
    !demo.columns<[i: 3, j: 2], !demo.padded<[i: 2, j: 6], 8, {x: f64, x_grad: f64}>>,
    {loss: f64, loss_grad: f64}>
tai.field @x_grad = @t["x_grad"] : f64, rank 2
tai.field @x = @t["x"] : f64, rank 2, adjoint @x_grad
tai.field @loss_grad = @t["loss_grad"] : f64, rank 0
tai.field @loss = @t["loss"] : f64, rank 0, adjoint @loss_grad

// x[i, j] = 10 i + j in the blocks of the diagonal i / 2 == j / 6.
tai.kernel @fill() {
  %c0 = arith.constant 0 : index
  %c6 = arith.constant 6 : index
  %c12 = arith.constant 12 : index
  %c2 = arith.constant 2 : index
  %ten = arith.constant 10 : index
  tai.parallel_for (%i, %j) = (%c0, %c0) to (%c6, %c12) {
    %a = arith.divui %i, %c2 : index
    %b = arith.divui %j, %c6 : index
    %same = arith.cmpi eq, %a, %b : index
    scf.if %same {
      %row = arith.muli %i, %ten : index
      %sum = arith.addi %row, %j : index
      %n = arith.index_cast %sum : index to i32
      %v = arith.sitofp %n : i32 to f64
      tai.store %v, @x[%i, %j] : f64
    }
  }
  tai.return
}

// The sum of squares, over active cells.
tai.kernel @sum() {
  tai.parallel_for (%i, %j) in @x {
    %v = tai.load @x[%i, %j] : f64
    %q = arith.mulf %v, %v : f64
    %old = tai.atomic add %q, @loss[] : f64
  }
  tai.return
}

// Takes away the block that holds (0, 0), which starts as zero again.
tai.kernel @drop() {
  %c0 = arith.constant 0 : index
  tai.deactivate @x[%c0, %c0] level 2
  tai.return
}

func.func @main() {
  tai.launch @fill() : () -> ()
  tai.launch @drop() : () -> ()
  tai.tape loss(@loss) {
    tai.launch @sum() : () -> ()
  }
  return
}

// CHECK:      @x : 6x12xf64 =
// CHECK-NEXT: {{^\[\[}}0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0],
// CHECK-NEXT: [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0],
// CHECK-NEXT: [0, 0, 0, 0, 0, 0, 26, 27, 28, 29, 3e+01, 31],
// CHECK-NEXT: [0, 0, 0, 0, 0, 0, 36, 37, 38, 39, 4e+01, 41],
// CHECK-NEXT: [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0],
// CHECK-NEXT: [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]]
// CHECK-NEXT: @x_grad : 6x12xf64 =
// CHECK-NEXT: [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0],
// CHECK-NEXT: [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0],
// CHECK-NEXT: [0, 0, 0, 0, 0, 0, 52, 54, 56, 58, 6e+01, 62],
// CHECK-NEXT: [0, 0, 0, 0, 0, 0, 72, 74, 76, 78, 8e+01, 82],
// CHECK-NEXT: [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0],
// CHECK-NEXT: [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]]
// CHECK-NEXT: @loss : f64 = 13802
