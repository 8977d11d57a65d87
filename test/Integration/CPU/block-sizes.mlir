// Loops that say how large their blocks are have the same results as without:
// here under a tape, with a stencil whose gradient is gathered. Sizes that no
// GPU has are refused where there is one.
//
// RUN: split-file %s %t
// RUN: tai-run %t/sizes.mlir
// RUN: tai-run %t/odd.mlir
// RUN: env TAI_CUDA_EMULATION=1 tai-run --arch=cuda %t/sizes.mlir --no-cache
// RUN: env TAI_CUDA_EMULATION=1 tai-run --arch=cuda %t/sizes.mlir --no-cache --deterministic
// RUN: not env TAI_CUDA_EMULATION=1 tai-run --arch=cuda %t/odd.mlir --no-cache 2>&1 | FileCheck %t/odd.mlir

//--- sizes.mlir
tai.tree @t : !tai.root<dense<[i: 64], {x: f64, x_grad: f64, y: f64, y_grad: f64}>, {loss: f64, loss_grad: f64}>
tai.field @x_grad = @t["x_grad"] : f64, rank 1
tai.field @x = @t["x"] : f64, rank 1, adjoint @x_grad
tai.field @y_grad = @t["y_grad"] : f64, rank 1
tai.field @y = @t["y"] : f64, rank 1, adjoint @y_grad
tai.field @loss_grad = @t["loss_grad"] : f64, rank 0
tai.field @loss = @t["loss"] : f64, rank 0, adjoint @loss_grad

tai.kernel @fill() {
  %half = arith.constant 0.5 : f64
  tai.parallel_for (%i) in @x block_dim 1024 {
    %i32 = arith.index_cast %i : index to i32
    %0 = arith.sitofp %i32 : i32 to f64
    %1 = arith.addf %0, %half : f64
    %2 = math.sin %1 : f64
    tai.store %2, @x[%i] : f64
  }
  tai.return
}

tai.kernel @step() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c63 = arith.constant 63 : index
  tai.parallel_for (%i) in @x block_dim 32 {
    %next = arith.addi %i, %c1 : index
    %last = arith.cmpi eq, %i, %c63 : index
    %wrapped = arith.select %last, %c0, %next : index
    %0 = tai.load @x[%i] : f64
    %1 = tai.load @x[%wrapped] : f64
    %2 = arith.mulf %0, %1 : f64
    tai.store %2, @y[%i] : f64
  }
  tai.parallel_for (%i) in @y block_dim 8 {
    %0 = tai.load @y[%i] : f64
    %1 = arith.mulf %0, %0 : f64
    %2 = tai.atomic add %1, @loss[] : f64
  }
  tai.return
}

func.func @main() {
  tai.launch @fill() : () -> ()
  tai_check.gradient loss(@loss) wrt [@x] tolerance 1.0e-7 {
    tai.launch @step() : () -> ()
  }
  return
}

//--- odd.mlir
tai.tree @t : !tai.root<dense<[i: 64], {x: f64}>>
tai.field @x = @t["x"] : f64, rank 1
tai.kernel @odd_loop() {
  %half = arith.constant 0.5 : f64
  // CHECK: odd.mlir:[[@LINE+1]]:3: error: {{.*}}has block_dim 48; on a GPU it is a multiple of 32 or a power of two, and 1024 at most
  tai.parallel_for (%i) in @x block_dim 48 {
    tai.store %half, @x[%i] : f64
  }
  tai.return
}

func.func @main() {
  tai.launch @odd_loop() : () -> ()
  return
}
