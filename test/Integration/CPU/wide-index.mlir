// RUN: sed -e 's/AT/1125899906842624/' %s | not tai-run - --no-cache 2>&1 | FileCheck %s
// RUN: sed -e 's/AT/9223372036854775807/' %s | not tai-run - --no-cache 2>&1 | FileCheck %s
// RUN: sed -e 's/AT/-9223372036854775808/' %s | not tai-run - --no-cache 2>&1 | FileCheck %s
// RUN: sed -e 's/AT/7/' %s | tai-run - --no-cache

// Indices of 64 bits are checked wherever they are, also where no storage
// reaches; ranges without iterations are fine there.
// CHECK: error: index [{{-?[0-9]+}}] is out of range for field '@x' of shape [8]

tai.tree @t : !tai.root<dense<[i: 8], {x: f32}>>
tai.field @x = @t["x"] : f32, rank 1

tai.kernel @single(%i: index) {
  %one = arith.constant 1.0 : f32
  tai.store %one, @x[%i] : f32
  tai.return
}

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
  %at = arith.constant AT : index
  tai.launch @range(%most, %least) : (index, index) -> ()
  tai.launch @range(%most, %most) : (index, index) -> ()
  tai.launch @single(%at) : (index) -> ()
  return
}
